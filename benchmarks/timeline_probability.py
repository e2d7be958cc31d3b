"""Is the probability that a grasp is right calibrated in timelines? ``python -m benchmarks.timeline_probability OUT
DEXYCB YCB [WORKERS]``.

DEXYCB and YCB are the folders of the dataset and of its models. Timelines with true segments are reconstructed under
the ``CONDITIONS`` of single grasps. Signs of their grasps go into OUT/results.csv; rows that are there are kept, so
that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.signed_results import COLUMNS, CONDITIONS, Case, ReadClip, Row, collect
from getagrip.batch.pool import cores
from getagrip.checks.signs import SIGNS
from getagrip.datasets.synthetic.splits import Split
from getagrip.experiments.sources import source_of
from getagrip.experiments.stamp import stamp
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries
from getagrip.timelines.reconstruct import reconstruct

EVERY: dict[Split, int] = {"train": 3, "test": 6}
"""Every so many of the timelines are used."""


def cases(clips: Path, root: Path, meshes: Path, parts: tuple[Split, ...]) -> Iterator[Case]:
    """Timeline by timeline."""
    for part in parts:
        found = source_of("dexycb-timelines", split=part, root=root, meshes=meshes).samples(clips, False)[0]
        for sample in found[:: EVERY[part]]:
            yield Case("DexYCB", part, sample.name, tuple(CONDITIONS), ReadClip(sample.folder))


def run(case: Case) -> list[Row]:
    """A row for each grasp under each condition, none for one that fails."""
    clip, masks = case.make()
    rows = []
    for condition in case.conditions if any(s.state == "grasp" for s in clip.segments) else ():
        start = time.process_time()
        try:
            given, seen = CONDITIONS[condition](clip, masks, 0)
            result = reconstruct(given, seen)
        except Exception as error:  # one clip's trouble must not end the others
            print(f"{case.clip}, {condition}: {error}", file=sys.stderr)
            continue
        seconds = time.process_time() - start
        assert given.truth is not None
        hand = given.hand.T_cam_hand if result.T_cam_hand is None else result.T_cam_hand
        symmetries = find_symmetries(given.mesh)
        for segment, record in zip(given.segments, result.segments, strict=True):
            if "signs" not in record:
                continue
            at = segment.rows
            found = ObjectTrack((hand @ result.T_hand_obj)[at], result.scale)
            true = ObjectTrack(given.truth.T_cam_obj[at], given.truth.scale)
            errors = pose_errors(given.mesh, found, true, best_symmetry(given.mesh, found, true, symmetries))
            what = [case.dataset, case.part, condition, case.clip, f"{errors.success:d}"]
            signs = [f"{record['signs'][sign.name]:.6g}" for sign in SIGNS]
            off = f"{errors.add.mean() / errors.diameter:.4f}"
            rows.append(dict(zip(COLUMNS, [*what, off, f"{seconds:.2f}", stamp(), *signs], strict=True)))
    return rows


if __name__ == "__main__":
    out, root, meshes = map(Path, sys.argv[1:4])
    workers = int(sys.argv[4]) if len(sys.argv) > 4 else cores()
    collect(out / "results.csv", list(cases(out / "clips", root, meshes, ("train",))), workers, run)
