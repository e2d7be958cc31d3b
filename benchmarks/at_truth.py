"""Search or energy? ``python -m benchmarks.at_truth DIR`` (as given to ``bench --out``) writes into docs/results.md.

For every clip on which soft-hinge failed: the energies after fitting with the last stage, for as long, from the poses
that it found and from the true ones, and how far off each is. A lower energy at the true poses is a failure of the
search, a higher one a failure of the energy; within ``ALIKE`` of each other the energy does not distinguish the two.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks import page
from getagrip.clip import read_clip
from getagrip.experiments.stamp import stamp
from getagrip.fitting.methods.all_frames import SOFT_RIDGE, coarse_energy, steady
from getagrip.fitting.motion import Fixed, Hinge, PosesInHand, Soft
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare
from getagrip.fitting.solve import minimise
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.pose import SUCCESS, ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries
from getagrip.result import read_result

LEVEL, ITERATIONS = 256, 40
ALIKE = 0.02
"""Energies that differ by less, as a share of the lower one, are alike."""


def settled(problem: Problem, start: ObjectTrack) -> tuple[float, ObjectTrack]:
    """The energy and the poses at the end of a fit from some poses."""
    clip = problem.clip
    N, middle = len(clip), len(clip) // 2
    R = start.T_hand_obj[:, :3, :3]
    centre = start.T_hand_obj[:, :3, 3] + start.scale * R @ clip.mesh.centre
    base = Fixed(R[middle][None], centre[middle][None], np.log([start.scale]), N, clip.scale == "free")
    deviation = np.concatenate([centre - centre[middle], se3.log_so3(R @ R[middle].T)], axis=-1)[None]
    hinge = Hinge.nearest(base, deviation, free_location=True, anchor=np.zeros(3))
    motion = Soft.around(hinge, PosesInHand(R[None], centre[None], np.array([start.scale])), SOFT_RIDGE)
    terms = steady(problem, coarse_energy(problem))(LEVEL, np.arange(N))
    solution = minimise(motion, terms, clip.hand.T_cam_hand, ITERATIONS)
    held = solution.motion.poses()
    R, scale = held.R[0], float(held.scale[0])
    return float(solution.energy[0]), ObjectTrack(se3.rigid(R, held.centre[0] - scale * R @ clip.mesh.centre), scale)


def share_off(mesh: Mesh, track: ObjectTrack, true: ObjectTrack) -> float:
    """ADD up to symmetries, as a share of the diameter."""
    errors = pose_errors(mesh, track, true, best_symmetry(mesh, track, true, find_symmetries(mesh)))
    return float(errors.add.mean()) / (mesh.diameter * true.scale)


def blame(found: float, at_truth: float) -> str:
    """The energy or the search."""
    if abs(found - at_truth) < ALIKE * min(found, at_truth):
        return "energy: alike"
    return "energy" if found < at_truth else "search"


def main(folder: Path) -> None:
    """Put the table into the page."""
    rows: list[list[str]] = []
    for place in sorted((folder / "results" / "soft-hinge").iterdir()):
        result, _ = read_result(place)
        problem = prepare(read_clip(folder / "clips" / result.clip), None, Options())
        clip = problem.clip
        truth = clip.truth
        assert truth is not None
        true = ObjectTrack(se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj, truth.scale)
        found = ObjectTrack(result.T_hand_obj, result.scale)
        off = share_off(clip.mesh, found, true)
        if off < SUCCESS:
            continue
        (best, _), (at_truth, from_truth) = settled(problem, found), settled(problem, true)
        best = min(best, result.energy["total"])
        shares = [f"{100.0 * share:.0f}" for share in (off, share_off(clip.mesh, from_truth, true))]
        energies = [f"{energy / len(clip):.0f}" for energy in (best, at_truth)]
        rows.append([result.clip, shares[0], energies[0], shares[1], energies[1], blame(best, at_truth)])
    header = ["clip", "ADD sym., % of diameter", "energy per frame", "from the truth: ADD", "energy", "to blame"]
    kinds = Counter(row[-1] for row in rows)
    summary = f"{len(rows)} failures: {', '.join(f'{n} {kind}' for kind, n in sorted(kinds.items()))}.\n\n"
    page.write(f"{folder.name}-truth", f"*Made {stamp()}.*\n\n{summary}{page.table(header, rows)}", "results.md")
    print(summary + page.table(header, rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
