"""Why HOMan does better here than in the paper: ``python -m benchmarks.homan_gap NAME CLIPS [N [WORKERS]]``.

N clips with ground truth, evenly sampled; ``NAME`` begins the table's name, and starts are learnt from all clips. From
our HOMan, one step more in each row leads to what the authors will have run: the paper's starts, HOMan's own choice of
one track, stiffer tracks up to its weights of smoothness and interaction, converted (docs/method.md). Contact is
measured within 10 mm, and at 0 mm as in the paper.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks import store
from benchmarks.store import Cell, Column, Table
from benchmarks.timing import circumstances
from getagrip import Options, evaluate, read_clip, read_masks, reconstruct
from getagrip.commands.learn_poses import LearnPoses
from getagrip.experiments.comparison import estimate
from getagrip.fitting.methods import homan, homan_refine
from getagrip.fitting.options import PriorsFile
from getagrip.metrics.contact import at_millimetres

CONTACTS = at_millimetres((10.0, 0.0))
METRICS = {
    "iou": ("IOU", "iou"), "add": ("ADD", "add_success"), "add_sym": ("ADD sym.", "add_sym_success"),
    "sca_add": ("SCA-ADD", f"sca_add_{CONTACTS[0].key}"), "sca_add_0": ("SCA-ADD, 0 mm", f"sca_add_{CONTACTS[1].key}"),
}  # fmt: skip


@dataclass(frozen=True)
class Step:
    """How HOMan is run: ours, but for these."""

    label: str
    its_starts: bool = True
    tracks: int = 1
    smooth: float = homan_refine.SMOOTH
    interact: float = homan_refine.INTERACT


STEPS = (
    Step("ours", its_starts=False, tracks=homan.TRACKS),
    Step("+ the paper's starts", tracks=homan.TRACKS),
    Step("+ one track, by its masks"),
    *(Step(f"+ smoothness {w:.0e}", smooth=w) for w in (1e6, 3e6)),
    Step("+ published weights", smooth=1e9, interact=2e7),
)


def measured(step: Step, priors: Path, folder: Path) -> tuple[str, list[float]]:
    """Run HOMan on a clip: its subject, and ``METRICS``."""
    homan.TRACKS, homan_refine.SMOOTH, homan_refine.INTERACT = step.tracks, step.smooth, step.interact
    starts = {"init": "priors", "priors": PriorsFile(priors), "priors_only": True} if step.its_starts else {}
    clip = read_clip(folder)
    masks = read_masks(clip)
    options = Options(method="homan", hands="as-given", every_frame=False, **starts)  # type: ignore[arg-type]
    metrics = evaluate(reconstruct(clip, masks, options), clip, masks, CONTACTS).metrics
    return str(clip.provenance.get("subject", clip.name)), [metrics[key] for _, key in METRICS.values()]


def main(name: str, clips: Path, count: int = 10**6, workers: int = 1) -> None:
    """Measure, and write ``results/NAME-homan-gap.json`` after each row."""
    folders, rows = sorted(path.parent for path in clips.glob("*/truth.npz")), list[dict[str, Cell]]()
    if count < len(folders):
        folders = [folders[k] for k in np.linspace(0, len(folders) - 1, count).round().astype(int)]
    columns = [Column("clips", "clips"), *(Column(k, label, "%", 1) for k, (label, _) in METRICS.items())]
    made = circumstances(f"python -m benchmarks.homan_gap {name} CLIPS {len(folders)}")
    with tempfile.TemporaryDirectory() as place, get_context("spawn").Pool(workers) as pool:
        priors = Path(place) / "priors"
        LearnPoses(clips=(clips,), out=Path(place) / "starts.npz", as_folder=priors, way="axis-angle").run()
        for step in STEPS:
            subjects, found = zip(*pool.imap(partial(measured, step, priors), folders), strict=True)
            means = [estimate(values, subjects) for values in np.array(found, dtype=float).T]
            cells = [[round(100 * v, 1) for v in (m.mean, m.low, m.high) if not np.isnan(v)] for m in means]
            rows.append({"label": step.label, "clips": len(found), **dict(zip(METRICS, cells, strict=True))})
            print(rows[-1], flush=True)
            store.write(f"{name}-homan-gap", Table("HOMan, from ours to the paper's", made, columns, rows))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:]))
