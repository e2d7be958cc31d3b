"""Modalities, for some or all frames of a clip: the direction of the object's z axis, and the place of the wrist."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Modality
from getagrip.fitting.energy import HandInCamera, Quadratic, Terms
from getagrip.fitting.objective import energy_of_nat
from getagrip.fitting.problem import Problem
from getagrip.io import arrays, files
from getagrip.io.array_data import ArrayData
from getagrip_upright.method import UprightTerm

WRIST = 0
"""Of the 21 joints."""
ERROR = 0.005
"""Standard error of the wrist's place [m]."""


@dataclass(frozen=True, eq=False)
class Vectors(ArrayData):
    """Vectors in the camera frame; NaN in frames of which nothing is known."""

    values: Float[ndarray, "T 3"]

    def __len__(self) -> int:
        return len(self.values)

    def take(self, index: np.ndarray) -> "Vectors":
        return Vectors(self.values[index])


class Seen(Modality[Vectors]):
    """``<name>.npz`` of a clip: names of ``frames``, and a vector for each, under ``key``."""

    key: str

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [f"{self.name}.npz"] if (folder / f"{self.name}.npz").exists() else []

    def read(self, clip: Clip) -> Vectors | None:
        if clip.folder is None or not self.files(clip.folder, clip.frames):
            return None
        path = files.inside(clip.folder, f"{self.name}.npz", "", f"the {self.name} in each frame")
        content = arrays.read(path, {"frames", self.key}.__contains__)
        row = {str(name): n for n, name in enumerate(content["frames"])}
        known = arrays.floats(path, content, self.key, (len(row), 3))
        unknown = np.full(3, np.nan)
        return Vectors(np.stack([known[row[name]] if name in row else unknown for name in clip.frames]))

    def write(self, clip: Clip, folder: Path) -> None:
        if (data := self.of(clip)) is not None:
            known = np.isfinite(data.values).all(axis=1)
            stored = {"frames": np.array(clip.frames)[known], self.key: data.values[known]}
            arrays.write(folder / f"{self.name}.npz", stored)


class SeenAxis(Seen):
    """The object's z axis, a direction of length 1."""

    name, key = "axis", "direction"

    def terms(self, problem: Problem) -> Terms | None:
        """A term on the object."""
        axes = self.of(problem.clip)
        if axes is None:
            return None
        return Terms(object=lambda level, at: [UprightTerm(1e3, "axis", axes.values[at])])


class SeenWrist(Seen):
    """The place of the wrist [m]."""

    name, key = "wrist", "position"

    def terms(self, problem: Problem) -> Terms | None:
        """A term on the hand, which counts where an estimated hand is solved with the object."""
        wrists, joints = self.of(problem.clip), problem.clip.hand.joints
        if wrists is None or joints is None:
            return None
        weight = 0.5 * energy_of_nat(problem) / ERROR**2
        return Terms(hand=lambda level, at: [WristTerm(weight, joints[at, WRIST], wrists.values[at])])


@dataclass(frozen=True)
class WristTerm:
    """``weight * |X - seen|^2`` in each frame, X a ``point`` of the hand; nothing where it was not seen."""

    weight: float
    point: Float[ndarray, "N 3"]
    seen: Float[ndarray, "N 3"]
    name: str = "wrist"

    def __call__(self, poses: HandInCamera, bound: np.ndarray) -> Quadratic:
        arm = poses.scale[:, None, None] * (poses.R @ (self.point - poses.middle)[..., None])[..., 0]
        J = np.zeros((*arm.shape, poses.size))  # by the hand's local vector: shift, turn, log size, fingers
        J[..., :3] = np.eye(3)
        J[..., 3:6] = np.cross(np.eye(3), arm[..., None, :]).swapaxes(-1, -2)
        J[..., 6] = arm
        known = np.isfinite(self.seen).all(axis=-1)[..., None]
        error = np.where(known, arm + poses.centre - self.seen, 0.0)
        return Quadratic.of_squares(error, J * known[..., None], self.weight)


AXIS, SEEN_WRIST = SeenAxis(), SeenWrist()
