"""A modality: where a sensor on the object says that its z axis points, in ``axes.txt`` of a clip's folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.clip import Clip, Modality
from getagrip.errors import InputError
from getagrip.fitting.energy import Terms
from getagrip.fitting.problem import Problem
from getagrip_upright.upright import AxisTerm

FILE = "axes.txt"
"""A line per frame: its name, and x, y, z in the camera frame."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Of T frames."""

    axis: np.ndarray

    def __len__(self) -> int:
        return len(self.axis)

    def take(self, index: np.ndarray) -> "Axes":
        """Those of some of the frames."""
        return Axes(self.axis[index])


class MeasuredAxes(Modality[Axes]):
    """It counts in every method that fits all frames."""

    name = "axes"

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [FILE] if (folder / FILE).is_file() else []

    def read(self, clip: Clip) -> Axes | None:
        if clip.folder is None or not self.files(clip.folder, clip.frames):
            return None
        path = clip.folder / FILE
        lines = dict(line.split(maxsplit=1) for line in path.read_text(encoding="utf-8").splitlines())
        if lacking := [name for name in clip.frames if name not in lines]:
            raise InputError(path, "", f"no {lacking[0]}", "a line for each frame")
        return Axes(np.array([lines[name].split() for name in clip.frames], dtype=float))

    def write(self, clip: Clip, folder: Path) -> None:
        if (axes := self.of(clip)) is not None:
            rows = (f"{name} {x} {y} {z}\n" for name, (x, y, z) in zip(clip.frames, axes.axis, strict=True))
            (folder / FILE).write_text("".join(rows), encoding="utf-8")

    def terms(self, problem: Problem) -> Terms:
        axes = self.of(problem.clip)
        if axes is None:
            return Terms()
        return Terms(object=lambda level, frames: [AxisTerm("axes", axes.axis[frames], 100.0)])


AXES = MeasuredAxes()
