"""Collect the rows for ``benchmarks.kept``: ``python -m benchmarks.kept_rows OUT CLIPS DEXYCB YCB [WORKERS [MOST]]``.

CLIPS is the folder of clips of ``bench dexycb``, imported if missing, at most MOST of each part, evenly spaced;
CLIPS/real holds clips of ARCTIC with an estimator's hands, if any. Each result is a line of OUT/rows.jsonl; existing
lines are kept, so an interrupted call continues. The first seed of all clips comes first, so an unfinished file is a
sample of all cases.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Protocol, TypeVar
from zlib import crc32

import numpy as np
from numpy import ndarray

from getagrip.batch.executor import available_cores, run_in_processes
from getagrip.batch.scheduling import SchedulingOptions
from getagrip.bench.inputs.perturbations import UNCHANGED, Change, EstimatedHands, Several
from getagrip.bench.inputs.simulated_evidence import SimulatedDepth, SimulatedJoints
from getagrip.bench.sources import sample_clips
from getagrip.bench.sources.recorded import DexYcb
from getagrip.checks.calibration import kind_of_input
from getagrip.checks.features import was_corrected
from getagrip.clip import Clip, read_clip, read_masks, write_clip
from getagrip.fitting.options import Options
from getagrip.io.plugins import date_and_commit
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_SYM, ADD_SYM_CAM, Metric
from getagrip.provenance import kind_of_hands
from getagrip.readers.datasets.tracks import subject_from_clip_name
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

ROWS, END = "rows.jsonl", "\t"
"""The file, and the end of a complete row, which JSON never contains."""
ESTIMATED = EstimatedHands(replace(NOISE_PRESETS["estimated"], mask_ragged_px=0.0))
JOINTS = "landmarks", "wild", "lab"
"""Error levels of 2D joints, by seed: the calibration must hold at each."""
SYNTHETIC, SCENES = "synthetic", range(300_000, 300_011)
"""The synthetic part, and its seeds for each category: DexYCB's wrong training results are of only 32 clips."""
REAL, REAL_APART = "real", "real, other objects"
"""Parts with an estimator's hands: with ``REAL_OBJECTS``, and with other objects."""
REAL_OBJECTS = "box", "espressomachine", "laptop", "mixer", "phone", "waffleiron"
SEEDS = {"train": 3, "validation": 3}
"""Number of error draws for each clip; exact hands are reconstructed once."""
Row = dict[str, Any]


class Keyed(Protocol):
    """A case with a key that identifies its row."""

    @property
    def key(self) -> tuple[object, ...]: ...


C = TypeVar("C", bound=Keyed)


def conditions(seed: int) -> Mapping[str, Change]:
    """Return the changes of a clip by name; evidence is simulated from the true hand, before the hand's errors."""
    joints = SimulatedJoints(JOINTS[seed])
    mono, sensor = SimulatedDepth("mono"), SimulatedDepth("realsense")
    return {
        "exact": UNCHANGED,
        "exact, depth of a network": mono,
        "estimated": ESTIMATED,
        "2D joints": Several((joints, ESTIMATED)),
        "2D joints, depth of a network": Several((joints, mono, ESTIMATED)),
        "2D joints, depth of a sensor": Several((joints, sensor, ESTIMATED)),
    }


@dataclass(frozen=True)
class Case:
    """A clip and its change."""

    folder: Path
    part: str
    condition: str
    seed: int

    @property
    def key(self) -> tuple[str, str, int]:
        """Key of the row."""
        return self.folder.name, self.condition, self.seed


def cases(clips: Path, root: Path, meshes: Path, workers: int, most: int) -> Iterator[Case]:
    """Yield all cases of DexYCB, the first seed of all clips first."""
    share = SchedulingOptions(workers=workers)
    sources = {part: DexYcb(split=part, root=root, meshes=meshes) for part in SEEDS}
    parts = {part: sample_clips(source, clips, most, False, share)[0] for part, source in sources.items()}
    for seed in range(max(SEEDS.values())):
        for part, found in parts.items():
            for sample, condition in product(found, conditions(seed)):
                if seed < (1 if condition.startswith("exact") else SEEDS[part]):
                    yield Case(sample.folder, part, condition, seed)


def scenes(clips: Path, workers: int) -> Iterator[Case]:
    """Make the synthetic clips, and yield their cases with estimated hands, one draw each."""
    jobs = [(clips, n, category, seed) for seed in SCENES for n, category in enumerate(SYNTHETIC_CATEGORIES)]
    folders = dict(run_in_processes(scene, jobs, workers))
    for n, job in enumerate(jobs):
        draw = n % len(JOINTS)
        estimated = [each for each in conditions(draw) if not each.startswith("exact")]
        yield from (Case(folder, SYNTHETIC, each, draw) for each in estimated if (folder := folders[job]))


def real(clips: Path) -> Iterator[Case]:
    """Yield the cases of clips with an estimator's hands, one draw of the evidence's errors each."""
    for folder in sorted(file.parent for file in clips.glob("*/clip.json")):
        part = REAL if read_clip(folder).category in REAL_OBJECTS else REAL_APART
        draw = crc32(folder.name.encode()) % len(JOINTS)
        yield from (Case(folder, part, each, draw) for each in conditions(draw) if not each.startswith("exact"))


def scene(job: tuple[Path, int, str, int]) -> Path:
    """Make a missing synthetic clip, with motion statistics measured in DexYCB."""
    clips, n, category, seed = job
    folder, rng = clips / f"syn{seed}--{seed}--{category}", np.random.default_rng([seed, n])
    options = SceneOptions(
        motion="measured", side=("right", "left")[(n + seed) % 2], other_hand=bool(rng.random() < 0.3), grip_deg=12.0,
        turn_deg=(5.0, 60.0), residual_deg=float(rng.uniform(0.5, 4.0)), residual_mm=float(rng.uniform(0.5, 2.0)),
    )  # fmt: skip
    if not folder.exists():
        clip, masks = synthesise(category, seed, options)
        write_clip(replace(clip, name=folder.name), masks, folder)
    return folder


def row(case: Case) -> Row | None:
    """Reconstruct a case, and return its row; None on failure."""
    clip = read_clip(case.folder)
    try:
        clip, masks = conditions(case.seed)[case.condition](clip, read_masks(clip), case.seed)
        result = reconstruct(clip, masks, Options(every_frame=False))
    except Exception as error:  # an error in one clip must not end the others
        print(f"{case}: {error}", file=sys.stderr)
        return None
    return {
        "clip": clip.name, "subject": subject_from_clip_name(clip.name), "category": clip.category, "part": case.part,
        "condition": case.condition, "seed": case.seed, **described(result, clip),
    }  # fmt: skip


def described(result: Reconstruction, clip: Clip) -> Row:
    """Return a result's part of the row: kind of input, findings, features, rank of the first right candidate."""
    in_camera = [*zip(result.candidates.T_hand_obj, result.candidates.scale, strict=True)]
    in_hand = in_camera if result.hand_alternatives is None else [(T, result.scale) for T in result.in_hand]
    terms, depth = {*result.energy, *result.hand_energy}, result.signs.get("depth-images", 0.0)
    return {
        "made": date_and_commit(),
        "kind": kind_of_input(kind_of_hands(clip.provenance), terms, depth, was_corrected(result.signs)),
        "serious": [finding.check for finding in result.findings if finding.serious],
        "signs": result.signs, "checks": result.checks, "hand_energy": result.hand_energy,
        "diameter": clip.mesh.diameter, "energy": result.candidates.energy.tolist(),
        "rank": {"hand": rank(result, clip, in_hand, ADD_SYM), "camera": rank(result, clip, in_camera, ADD_SYM_CAM)},
    }  # fmt: skip


def rank(result: Reconstruction, clip: Clip, candidates: Sequence[tuple[ndarray, float]], metric: Metric) -> int | None:
    """Return the number of the first right candidate (poses and scale), from 1; None if all are wrong."""
    for n, (T, scale) in enumerate(candidates, start=1):
        one = replace(result, T_hand_obj=T, scale=float(scale))
        if evaluate(one, clip, None, wanted=(metric,)).metrics[metric.name] > 0.5:
            return n
    return None


def collect(
    file: Path, every: Sequence[C], by: Sequence[str], run: Callable[[C], Row | None], workers: int
) -> list[Row]:
    """Return the rows of all cases; missing ones are run and appended to the file. ``by``: entries of a row's key."""
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {tuple(one[key] for key in by) for one in read(file)}
    missing = [case for case in every if case.key not in done]
    with file.open("a", encoding="utf-8") as stream:
        for n, (case, new) in enumerate(run_in_processes(run, missing, workers), start=1):
            if new is not None:
                stream.write(f"\n{json.dumps(new)}{END}")
                stream.flush()
            print(f"{n} of {len(missing)}:", *case.key, flush=True)
    return read(file)


def read(file: Path) -> list[Row]:
    """Read the complete rows of a file; none if it does not exist."""
    lines = file.read_text("utf-8").splitlines() if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith(END)]


def main(out: Path, clips: Path, root: Path, meshes: Path, workers: int | None = None, most: int = 1000) -> None:
    """Import the clips, and collect the rows."""
    workers = workers or available_cores()
    every = [*real(clips / REAL), *cases(clips, root, meshes, workers, most), *scenes(clips / SYNTHETIC, workers)]
    collect(out / ROWS, every, ("clip", "condition", "seed"), row, workers)


if __name__ == "__main__":
    if len(sys.argv) < 5:
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:5]), *map(int, sys.argv[5:]))
