"""A modality: in which direction a detector has seen the object's z axis, for some or all frames of a clip."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Modality
from getagrip.fitting.energy import Terms
from getagrip.fitting.problem import Problem
from getagrip.io import arrays, files
from getagrip.io.array_data import ArrayData
from getagrip_upright.method import UprightTerm

FILE = "axis.npz"


@dataclass(frozen=True, eq=False)
class Axes(ArrayData):
    """Directions of length 1 in the camera frame; NaN in frames of which nothing is known."""

    direction: Float[ndarray, "T 3"]

    def __len__(self) -> int:
        return len(self.direction)

    def take(self, index: np.ndarray) -> "Axes":
        return Axes(self.direction[index])


class SeenAxis(Modality[Axes]):
    """``axis.npz`` of a clip: names of ``frames``, and a ``direction`` for each."""

    name = "axis"

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [FILE] if (folder / FILE).exists() else []

    def read(self, clip: Clip) -> Axes | None:
        if clip.folder is None or not self.files(clip.folder, clip.frames):
            return None
        path = files.inside(clip.folder, FILE, "", "the object's axis in each frame")
        content = arrays.read(path, {"frames", "direction"}.__contains__)
        row = {str(name): n for n, name in enumerate(content["frames"])}
        known = arrays.floats(path, content, "direction", (len(row), 3))
        unknown = np.full(3, np.nan)
        return Axes(np.stack([known[row[name]] if name in row else unknown for name in clip.frames]))

    def write(self, clip: Clip, folder: Path) -> None:
        if (axes := self.of(clip)) is not None:
            known = np.isfinite(axes.direction).all(axis=1)
            arrays.write(folder / FILE, {"frames": np.array(clip.frames)[known], "direction": axes.direction[known]})

    def terms(self, problem: Problem) -> Terms:
        """The term on the object; one on the hand would be ``Terms(hand=...)``."""
        axes = self.of(problem.clip)
        if axes is None:
            return Terms()
        return Terms(object=lambda level, at: [UprightTerm(1e3, "axis", axes.direction[at])])


AXIS = SeenAxis()
