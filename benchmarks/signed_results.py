"""Results with their signs, and whether they are right: what ``benchmarks.probability`` is fitted to and tested on.

Every clip is reconstructed by the default method under each of ``CONDITIONS``.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from getagrip.batch.executor import in_processes
from getagrip.checks.signs import SIGNS
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE, Noise
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.splits import Split, split
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_SYM, ADD_SYM_CAM, ADD_SYM_MM
from getagrip.experiments.changes import UNCHANGED, Noisy, OtherObject, ScaleFree
from getagrip.experiments.sources.recorded import DexYcb
from getagrip.fitting.options import Options
from getagrip.io.code import stamp
from getagrip.timelines.reconstruct import reconstruct

EVERY: dict[Split, tuple[int, int]] = {"train": (1, 3), "validation": (2, 5)}
"""Step from one clip that is used to the next: among DexYCB's, and among the synthetic ones of each preset."""
PRESETS = ("clean", "moderate", "strong", "estimated", "wild", "measured")
Change = Callable[[Clip, Masks, int], tuple[Clip, Masks]]
TEN = Noisy(Noise(hand_bias_mm=10.0, hand_bias_deg=8.0, hand_jitter_mm=5.0, hand_jitter_deg=4.0, jitter_memory_s=0.1))


def unseen_hand(clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
    """As far off as ``TEN``, and no pixels of the hand to mend it by."""
    clip, masks = TEN(clip, masks, seed)
    return clip, Masks(masks.object, np.zeros_like(masks.ignore))


CONDITIONS: dict[str, Change] = {
    "as it is": UNCHANGED,
    "moderate": Noisy(NOISE["moderate"]),
    "strong": Noisy(NOISE["strong"]),
    "estimated": Noisy(NOISE["estimated"]),
    "10 mm, 8°": TEN,
    "10 mm, 8°, no hand pixels": unseen_hand,
    "masks off by 4 px": Noisy(Noise(mask_ragged_px=4.0)),
    "size unknown": ScaleFree(),
    "other shape": OtherObject(),
}
"""What is done to the clips of DexYCB. Synthetic clips are as their preset has them."""


@dataclass(frozen=True)
class Case:
    """A clip, and what is to be done with it."""

    dataset: str
    part: Split
    clip: str
    conditions: tuple[str, ...]
    make: Callable[[], tuple[Clip, Masks]]


def read_from(folder: Path) -> tuple[Clip, Masks]:
    """Read a clip and its masks."""
    clip = read_clip(folder)
    return clip, read_masks(clip)


def cases(clips: Path, root: Path, meshes: Path) -> list[Case]:
    """All clips in a random order: what there is of an interrupted run is a sample of everything."""
    found = list(_cases(clips, root, meshes))
    return [found[n] for n in np.random.default_rng(0).permutation(len(found))]


def _cases(clips: Path, root: Path, meshes: Path) -> Iterator[Case]:
    """Clip by clip."""
    for part, (every, every_synthetic) in EVERY.items():
        found = DexYcb(split=part, root=root, meshes=meshes).samples(clips, False)[0]
        for sample in found[::every]:
            yield Case("DexYCB", part, sample.name, tuple(CONDITIONS), partial(read_from, sample.folder))
        for preset in PRESETS:
            for category, seed, options in split(part, preset)[::every_synthetic]:
                make = partial(synthesise, category, seed, options)
                yield Case("synthetic", part, f"{category}-{seed}", (preset,), make)


Row = dict[str, str]
COLUMNS = (
    "dataset", "part", "condition", "clip", "right", "right-in-camera", "off", "serious", "seconds", "made",
    *(sign.name for sign in SIGNS),
)  # fmt: skip
"""Of a row; "right" and "off" (mean distance of vertices, in diameters) are in the hand; "serious" is whether a finding
is.
"""


def run(case: Case) -> list[Row]:
    """A row for each condition, none for one that fails."""
    clip, masks = case.make()
    rows = []
    for condition in case.conditions:
        start = time.process_time()
        try:
            changed = clip, masks
            if case.dataset == "DexYCB":
                changed = CONDITIONS[condition](clip, masks, 0)
            result = reconstruct(*changed, Options(every_frame=False))
        except Exception as error:  # one clip's trouble must not end the others
            print(f"{case.clip}, {condition}: {error}", file=sys.stderr)
            continue
        seconds = time.process_time() - start
        given = changed[0]
        metrics = evaluate(result, given, None, wanted=(ADD_SYM, ADD_SYM_CAM, ADD_SYM_MM)).metrics
        assert given.truth is not None
        off = 1e-3 * metrics[ADD_SYM_MM.name] / (given.mesh.diameter * given.truth.scale)
        right = [f"{metrics[metric.name]:.0f}" for metric in (ADD_SYM, ADD_SYM_CAM)]
        serious, signs = any(f.serious for f in result.findings), [f"{result.signs[sign.name]:.6g}" for sign in SIGNS]
        what = case.dataset, case.part, condition, case.clip, *right, f"{off:.4f}", f"{serious:d}", f"{seconds:.2f}"
        rows.append(dict(zip(COLUMNS, [*what, stamp(), *signs], strict=True)))
    return rows


def collect(file: Path, every: Sequence[Case], workers: int, run: Callable[[Case], list[Row]] = run) -> list[Row]:
    """The rows of all cases: those of the file, and those that are missing there, which are added to it.

    Ends the program where the file has other columns: it was written by other code.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = read(file) if file.exists() else []
    if not rows:
        write([COLUMNS], file, "w")
    done = {(row["dataset"], row["part"], row["clip"], row["condition"]) for row in rows}
    missing = []
    for case in every:
        left = tuple(c for c in case.conditions if (case.dataset, case.part, case.clip, c) not in done)
        missing += [replace(case, conditions=left)] if left else []
    made = ((case, run(case)) for case in missing) if workers == 1 else in_processes(run, missing, workers)
    for n, (case, new) in enumerate(made, start=1):
        write([[row[column] for column in COLUMNS] for row in new or []], file, "a")
        rows += new or []
        print(f"{n} of {len(missing)}: {case.dataset}, {case.part}, {case.clip}", flush=True)
    return rows


def read(file: Path) -> list[Row]:
    """The rows of a file; ends the program where it has other columns."""
    with file.open(encoding="utf-8", newline="") as stream:
        table = csv.DictReader(stream)
        given = table.fieldnames or ()
        if given and tuple(given) != COLUMNS:
            sys.exit(f"{file}: columns must be {', '.join(COLUMNS)} (got {', '.join(given)}); name another OUT")
        return list(table)


def write(lines: Sequence[Sequence[str]], file: Path, mode: str) -> None:
    """Lines of a table."""
    with file.open(mode, encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows(lines)
