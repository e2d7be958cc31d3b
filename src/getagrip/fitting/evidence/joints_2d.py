"""2D joints of the hand (``joints_2d`` of ``hand.npz``): their checks and their term."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks import Check, Evidence
from getagrip.checks.check import format_percent
from getagrip.clip import Clip, Modality
from getagrip.fitting.energy import Terms
from getagrip.fitting.hand.joint_reprojection import MAX_OUTSIDE_MASK_FRACTION, outside_mask_fraction
from getagrip.io.array_data import ArrayData

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.problem import Problem


@dataclass(frozen=True, eq=False)
class Joints2D(ArrayData):
    """Joints of the hand in every frame, as detected or clicked.

    Attributes:
        points: (T, 21, 2) in the images [px].
        confidence: (T, 21) from 0 (invisible) to 1.
    """

    points: Float[ndarray, "T 21 2"]
    confidence: Float[ndarray, "T 21"]

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: Int[ndarray, "n"]) -> Joints2D:
        """Return the joints in some of the frames, in this order."""
        return Joints2D(self.points[index], self.confidence[index])


def joints_2d_excluded(it: Evidence) -> float:
    """Return 1 where the hand was refined without its 2D joints though they lie on the masks, else 0."""
    return float(it.joints_left_out and not outside_mask_fraction(it.clip, it.masks) > MAX_OUTSIDE_MASK_FRACTION)


def joints_2d_exclusion_reason(it: Evidence) -> str:
    """Explain why 2D joints were left out."""
    confidence = it.clip.hand.joints_2d_confidence
    why = "contradict its pixels or its skeleton"
    if it.clip.hand.joints is None:
        why = "have no joints in 3D to compare with"
    elif confidence is not None and np.count_nonzero(confidence.any(axis=1)) < 2:
        why = "have a confidence above 0 in less than two frames"
    return f"the hand's 2D joints {why}, and were left out"


class HandJoints2D(Modality[Joints2D]):
    """Places of the hand's joints in the images, which belong to the hand (``HandTrack.joints_2d``)."""

    name = "joints-2d"
    input_checks = (
        Check(
            "joints-elsewhere", lambda it: outside_mask_fraction(it.clip, it.masks), high=MAX_OUTSIDE_MASK_FRACTION,
            serious=False, shown=format_percent,
            fault="{value} of the hand's 2D joints are neither on the hand nor on the object",
            advice="they were left out; check that they are of this hand, and of images of this size",
        ),
    )  # fmt: skip
    result_checks = (
        Check(
            "joints-left-out", joints_2d_excluded, high=0.0, serious=False, fault=joints_2d_exclusion_reason,
            advice="import 2D joints of this hand, in pixels of these images and in the order of hand.npz",
        ),
    )  # fmt: skip

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return []  # hand.npz is a file of every clip

    def read(self, clip: Clip) -> None:
        return None

    def write(self, clip: Clip, folder: Path) -> None:
        return None

    def of(self, clip: Clip) -> Joints2D | None:
        points, confidence = clip.hand.joints_2d, clip.hand.joints_2d_confidence
        return None if points is None or confidence is None else Joints2D(points, confidence)

    def terms(self, problem: Problem) -> Terms | None:
        from getagrip.fitting.objective import reprojection_energy

        return None if self.of(problem.clip) is None else Terms(hand=reprojection_energy(problem))
