"""LeRobot's datasets: a column with the hand's joints in every frame, in its Parquet files (versions 2.1 and 3.0).

No name of such a column is usual, so it is stated: 42 numbers are 21 landmarks in the image (pixels, or shares of its
sides), 63 are 21 joints before the clip's camera [m]; 84 and 126 are both hands, the left one first. The joints are in
MediaPipe's order, which is OpenPose's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import InputError, MissingOptionError, unknown
from getagrip.hands.trackers.estimates import Estimates, Request
from getagrip.hands.trackers.joints import estimates
from getagrip.hands.trackers.landmarks import lifted
from getagrip.hands.trackers.recognition import Sample
from getagrip.hands.trackers.tracker import Tracker, frames_of_images
from getagrip.io import extras

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

LARGEST = 2**30
"""Bytes of the largest file."""


@dataclass(frozen=True)
class LeRobot(Tracker):
    """A column of joints in a dataset of LeRobot. It is needed."""

    name = "LeRobot"
    takes = "a column of joints or landmarks in its Parquet files"
    looks_for = "data/*/*.parquet"
    layouts = ("data/chunk-*/*.parquet", "chunk-*/*.parquet", "*.parquet")

    column: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """Column of the hand's numbers."""
    episode: Annotated[int, arg(metavar="N")] = 0
    """Episode of the dataset."""

    def recognises(self, sample: Sample) -> str:
        other = sample.path.name == "hand_tracking.parquet"  # EgoHandKit's
        return "a dataset of LeRobot" if sample.path.suffix.lower() == ".parquet" and not other else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand in those of the episode's frames that the clip has."""
        path, values = self._episode(paths)
        if values.shape[1] in (84, 126):
            left, right = np.split(values, 2, axis=1)
            values = left if request.side == "left" else right
        there = np.isfinite(values).all(axis=1) & (values != 0.0).any(axis=1)
        frames = frames_of_images(path, {}, len(values), request)
        if values.shape[1] == 42:
            seen = np.zeros((len(request.frames), 21, 4))
            for row, frame in enumerate(frames):
                if frame is not None and there[row]:
                    seen[frame] = np.column_stack([values[row].reshape(21, 2), np.ones(21), np.full(21, np.nan)])
            return lifted(path, seen, request)
        named = {"frames": [request.frames[n] for row, n in enumerate(frames) if n is not None and there[row]]}
        rows = [row for row, n in enumerate(frames) if n is not None and there[row]]
        if not rows:
            return Estimates(request.side, ())
        return estimates(path, named, values[rows].reshape(-1, 21, 3), "openpose", request)

    def _episode(self, paths: Sequence[Path]) -> tuple[Path, Float[ndarray, "T n"]]:
        """Read the column of the episode, from the first file that has it; raises ``UsageError`` without a column."""
        columns = list[str]()
        for path in paths:
            columns = columns_of(path)
            if self.column is None or self.column not in columns:
                continue
            table = read_columns(path, [self.column, *[name for name in INDICES if name in columns]])
            rows = [n for n, of in enumerate(table.get(INDICES[0], [])) if of == self.episode]
            if rows:
                try:
                    values = np.array([table[self.column][n] for n in rows], dtype=float)
                except (TypeError, ValueError) as error:
                    raise InputError(path, self.column, "rows that are no numbers of one count", COUNTS) from error
                if values.ndim != 2 or values.shape[1] not in (42, 63, 84, 126):
                    raise InputError(path, self.column, f"the shape {values.shape}", COUNTS)
                return path, values
        if self.column is None:
            raise MissingOptionError(f"missing --column: the hand's numbers; choose from {', '.join(columns)}")
        if self.column not in columns:
            raise unknown("--column", self.column, columns)
        raise InputError(paths[0], INDICES[0], f"no row of episode {self.episode}", "an episode of the dataset")


def columns_of(path: Path) -> list[str]:
    """Return the names of a Parquet file's columns. Raises as ``read_columns`` does."""
    return list(_opened(path).schema_arrow.names)


def read_columns(path: Path, names: Sequence[str]) -> dict[str, list[object]]:
    """Read columns of a Parquet file. Raises ``InputError``, and ``UsageError`` without pyarrow."""
    file = _opened(path)
    missing = next((name for name in names if name not in file.schema_arrow.names), None)
    if missing is not None:
        raise InputError(path, missing, "no such column", f"one of {', '.join(file.schema_arrow.names)}")
    try:
        return dict(file.read(list(names)).to_pydict())
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


def _opened(path: Path) -> ParquetFile:
    """Open a Parquet file."""
    parquet = extras.load("pyarrow.parquet", "lerobot", path.name)
    if path.stat().st_size > LARGEST:
        raise InputError(path, "", f"{path.stat().st_size} bytes", f"at most {LARGEST}")
    try:
        return parquet.ParquetFile(path)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


INDICES = ("episode_index", "frame_index")
COUNTS = "42, 63, 84 or 126 numbers in each row"
