"""LeRobot's datasets: a column with the hand's joints in every frame, in its Parquet files (versions 2.1 and 3.0).

No name of such a column is usual, so it is stated: 42 numbers are 21 landmarks in the image (pixels, or shares of its
sides), 63 are 21 joints before the clip's camera [m]; 84 and 126 are both hands, the left one first. The joints are in
MediaPipe's order, which is OpenPose's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

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
from getagrip.io.parquet import columns_of, read_columns


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
            if INDICES[0] not in columns:
                continue
            table = read_columns(
                path, [self.column, *[name for name in INDICES if name in columns]], (INDICES[0], self.episode)
            )
            values = table[self.column]
            if len(values):
                if values.ndim != 2 or values.shape[1] not in (42, 63, 84, 126):
                    raise InputError(path, self.column, f"the shape {values.shape}", COUNTS)
                return path, values
        if self.column is None:
            raise MissingOptionError(f"missing --column: the hand's numbers; choose from {', '.join(columns)}")
        if self.column not in columns:
            raise unknown("--column", self.column, columns)
        raise InputError(paths[0], INDICES[0], f"no row of episode {self.episode}", "an episode of the dataset")


INDICES = ("episode_index", "frame_index")
COUNTS = "42, 63, 84 or 126 numbers in each row"
