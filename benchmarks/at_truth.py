"""Search or energy? ``python -m benchmarks.at_truth DIR [ABLATION...]`` writes into docs/results-dexycb.md.

DIR is a folder of ``bench``.

For every clip on which soft-hinge failed: the energies after fitting with the last stage, for as long, from the poses
that it found and from the true ones, and how far off each is. A lower energy at the true poses is a failure of the
search, a higher one a failure of the energy; within ``ALIKE`` of each other the energy does not distinguish the two.
For each setting of the ablations: how many failures there are of each kind.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import page
from getagrip.clip import read_clip, read_masks
from getagrip.experiments.stamp import stamp
from getagrip.experiments.variants import Variant, ablation_variants, method_variants
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
METHOD = "soft-hinge"
KINDS = ("search", "energy", "energy: alike")


@dataclass(frozen=True)
class Failure:
    """A clip whose pose is wrong."""

    clip: str
    off: float
    """ADD up to symmetries, as a share of the diameter."""
    energy: float
    """Per frame, after a fit from the poses found."""
    off_from_truth: float
    """As ``off``, after a fit from the true poses."""
    energy_from_truth: float

    @property
    def blame(self) -> str:
        """What is to blame: one of ``KINDS``."""
        if abs(self.energy - self.energy_from_truth) < ALIKE * min(self.energy, self.energy_from_truth):
            return "energy: alike"
        return "energy" if self.energy < self.energy_from_truth else "search"

    def row(self) -> list[str]:
        """As a row of the table of failures."""
        numbers = (100.0 * self.off, self.energy, 100.0 * self.off_from_truth, self.energy_from_truth)
        return [self.clip, *(f"{number:.0f}" for number in numbers), self.blame]


def settled(problem: Problem, start: ObjectTrack) -> tuple[float, ObjectTrack]:
    """The energy and the poses at the end of a fit from some poses."""
    clip = problem.clip
    N, middle = len(clip), len(clip) // 2
    R = start.T_ref_obj[:, :3, :3]
    centre = start.T_ref_obj[:, :3, 3] + start.scale * R @ clip.mesh.centre
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


def failures(folder: Path, variant: Variant) -> tuple[int, list[Failure]]:
    """How many results a variant has, and those that are wrong."""
    places, wrong = sorted((folder / "results" / variant.folder).iterdir()), []
    for place in places:
        result, record = read_result(place)
        if record["metrics"]["add_sym_success"] == 1.0:
            continue
        clip = read_clip(folder / "clips" / result.clip)
        problem = prepare(*variant.change(clip, read_masks(clip), variant.options.seed), variant.options)
        clip = problem.clip
        assert clip.truth is not None
        true = ObjectTrack(se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj, clip.truth.scale)
        at = [list(result.frames).index(frame) for frame in clip.frames]
        found = ObjectTrack(result.T_hand_obj[at], result.scale)
        (energy, _), (energy_from_truth, from_truth) = settled(problem, found), settled(problem, true)
        if not len(result.frames_of("interpolated")):  # else it is the energy of fewer frames
            energy = min(energy, result.energy["total"])
        off = share_off(clip.mesh, found, true)
        per_frame = energy / len(clip), energy_from_truth / len(clip)
        wrong.append(Failure(result.clip, off, per_frame[0], share_off(clip.mesh, from_truth, true), per_frame[1]))
    return len(places), wrong


def main(folder: Path, ablations: Sequence[str]) -> None:
    """Put the tables into the page."""
    plain = method_variants([METHOD], Options())
    settings = {v.folder: v for name in ablations for v in ablation_variants(name, [METHOD], Options())}
    count, wrong = failures(folder, plain[0])
    kinds = Counter(failure.blame for failure in wrong)
    words = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
    header = ["clip", "ADD sym., % of diameter", "energy per frame", "from the truth: ADD", "energy", "to blame"]
    text = f"*Made {stamp()}.*\n\n{len(wrong)} of {count} clips failed: {words}.\n\n"
    text += page.table(header, [failure.row() for failure in wrong])
    if settings:
        rows = []
        for variant in settings.values():
            count, wrong = (count, wrong) if variant.folder == METHOD else failures(folder, variant)
            kinds = Counter(failure.blame for failure in wrong)
            right = f"{100.0 * (count - len(wrong)) / count:.1f}"
            near = sum(failure.off_from_truth < SUCCESS for failure in wrong)
            numbers = [right, *(str(n) for n in (len(wrong), *(kinds[kind] for kind in KINDS), near))]
            rows.append([variant.step, *numbers])
            print(rows[-1], flush=True)
        header = ["setting", "right, %", "failures", *KINDS, "right from the truth"]
        text += "\n\n" + page.table(header, rows)
    page.write(f"{folder.name}-truth", text)
    print(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
