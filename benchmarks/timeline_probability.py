"""The probability of single grasps in timelines: ``python -m benchmarks.timeline_probability OUT DEXYCB YCB [COUNT]``.

DEXYCB and YCB are the folders of the dataset and of its models. Timelines of training subjects, with true segments, are
reconstructed under the ``CONDITIONS`` of single grasps; COUNT: so many at most. Signs of their grasps go into
OUT/results.csv; rows that are there are kept, so that an interrupted run goes on where it stopped. The table goes into
docs/checks.md, between the markers "timeline-probability".
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from benchmarks import page
from benchmarks.probability import HEADER, METHOD, RIGHT, Results, line, of
from benchmarks.signed_results import COLUMNS, CONDITIONS, Case, ReadClip, Row, collect
from getagrip.checks.calibrated import CALIBRATIONS
from getagrip.checks.signs import SIGNS
from getagrip.datasets.tracks import subject_of
from getagrip.experiments.sources.dexycb import DexYcbTimelines
from getagrip.experiments.stamp import stamp
from getagrip.geometry import se3
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries
from getagrip.timelines.reconstruct import reconstruct

EVERY = 3
"""Of the timelines, every so many are used."""
SECTION = "timeline-probability"


def cases(clips: Path, root: Path, meshes: Path, count: int) -> list[Case]:
    """Timeline by timeline."""
    found = DexYcbTimelines(split="train", root=root, meshes=meshes).samples(clips, False)[0]
    return [
        Case("DexYCB", "train", sample.name, tuple(CONDITIONS), ReadClip(sample.folder))
        for sample in found[::EVERY][:count]
    ]


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
        symmetries, scales = find_symmetries(given.mesh), (result.scale, given.truth.scale)
        poses = {
            "hand": (result.T_hand_obj, se3.inverse(given.truth.T_cam_hand) @ given.truth.T_cam_obj),
            "camera": (hand @ result.T_hand_obj, given.truth.T_cam_obj),
        }
        for segment, record in zip(given.segments, result.segments, strict=True):
            if "signs" not in record:
                continue
            errors = {}
            for where, both in poses.items():
                found, true = (ObjectTrack(T[segment.rows], scale) for T, scale in zip(both, scales, strict=True))
                symmetry = best_symmetry(given.mesh, found, true, symmetries)
                errors[where] = pose_errors(given.mesh, found, true, symmetry)
            right = [f"{errors[where].success:d}" for where in RIGHT]
            what = [case.dataset, case.part, condition, case.clip, *right]
            signs = [f"{record['signs'][sign.name]:.6g}" for sign in SIGNS]
            off = f"{errors['hand'].add.mean() / errors['hand'].diameter:.4f}"
            serious = f"{record['probability_right'] is None:d}"  # then it has none
            rows.append(dict(zip(COLUMNS, [*what, off, serious, f"{seconds:.2f}", stamp(), *signs], strict=True)))
    return rows


def section(results: Results) -> str:
    """The table for the page; grasps with a serious finding have no probability, and are left out."""
    left, results = len(results.rows), results.only(serious="0")
    left -= len(results.rows)
    calibration = CALIBRATIONS[METHOD, "hand"]
    rows = [line(name, results.only(condition=name), calibration) for name in of(results, "condition")]
    subjects = {subject_of(row["clip"]) for row in results.rows}
    days = sorted({row["made"].split(",")[0] for row in results.rows})
    header = ["timelines", "grasps", *HEADER[2:]]
    about = (
        f"*Made {stamp()}; results of {' and '.join(days)}. {len(of(results, 'clip'))} timelines with a grasp, of "
        f"{len(subjects)} training subjects, by true segments.*"
    )
    without = f"\n\n{left} more grasps have no probability, since a finding was serious." if left else ""
    return f"{about}\n\n{page.table(header, [*rows, line('**all**', results, calibration)])}{without}"


if __name__ == "__main__":
    out, root, meshes = map(Path, sys.argv[1:4])
    every = cases(out / "clips", root, meshes, int(sys.argv[4]) if len(sys.argv) > 4 else sys.maxsize)
    names = {case.clip for case in every}
    rows = [row for row in collect(out / "results.csv", every, 1, run) if row["clip"] in names]
    text = section(Results(rows, "camera"))  # in which a timeline is held together
    page.write(SECTION, text)
    print(text)
