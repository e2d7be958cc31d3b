"""Search or energy? ``python -m benchmarks.at_truth DIR`` (as given to ``bench --out``) writes into docs/results.md.

For every clip on which soft-hinge failed: the energy that it found, and the energy after fitting from the true poses
with the last stage. A search that missed a lower energy is to blame for the one, the energy itself for the other.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks import page
from getagrip import se3
from getagrip.clip import read_clip
from getagrip.joint import terms_of
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries
from getagrip.motion import Fixed, Soft
from getagrip.options import Options
from getagrip.problem import Problem, prepare, read_sampled
from getagrip.result import read_result
from getagrip.search import COARSE_RIDGE, Schedule, soft_hinge
from getagrip.solve import minimise

ITERATIONS = 40


def from_truth(problem: Problem) -> float:
    """The energy at the end of a fit from the true poses."""
    clip = problem.clip
    assert clip.truth is not None
    N, middle = len(clip), len(clip) // 2
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    R, centre = T[:, :3, :3], T[:, :3, 3] + clip.truth.scale * T[:, :3, :3] @ clip.mesh.centre
    log_scale = np.log(np.array([clip.truth.scale]))
    base = Fixed(R[middle][None], centre[middle][None], log_scale, N, clip.scale == "free")
    deviation = np.concatenate([centre - centre[middle], se3.log_so3(R @ R[middle].T)], axis=-1)[None]
    start = soft_hinge(Soft(base, deviation, COARSE_RIDGE), free_location=True, anchor=np.zeros(3))
    terms = terms_of(problem)(Schedule().stages[-1], np.arange(N))
    return float(minimise(start, terms, clip.hand.T_cam_hand, ITERATIONS).energy[0])


def main(folder: Path) -> None:
    """Put the table into the page."""
    rows, blamed = [], {"energy": 0, "search": 0}
    for place in sorted((folder / "results" / "soft-hinge").iterdir()):
        result, _ = read_result(place)
        clip, masks = read_sampled(read_clip(folder / "clips" / result.clip), Options().frames)
        problem = prepare(clip, masks, Options())
        truth = problem.clip.truth
        assert truth is not None
        true = ObjectTrack(se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj, truth.scale)
        found = ObjectTrack(result.T_hand_obj, result.scale)
        errors = pose_errors(clip.mesh, found, true, best_symmetry(clip.mesh, found, true, find_symmetries(clip.mesh)))
        if errors.success:
            continue
        best, at_truth = result.energy["total"], from_truth(problem)
        to_blame = "energy" if best < at_truth else "search"
        blamed[to_blame] += 1
        off = 100.0 * float(errors.add.mean()) / (clip.mesh.diameter * truth.scale)
        rows.append([result.clip, f"{off:.0f}", f"{best / len(clip):.0f}", f"{at_truth / len(clip):.0f}", to_blame])
    header = ["clip", "ADD sym., % of diameter", "energy found, per frame", "from the truth", "to blame"]
    said = f"{len(rows)} failures: {blamed['energy']} of the energy, {blamed['search']} of the search.\n\n"
    page.write(f"{folder.name}-truth", said + page.table(header, rows), "results.md")
    print(said + page.table(header, rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
