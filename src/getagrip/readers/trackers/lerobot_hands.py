"""LeRobot's datasets: a column with the hand's joints in every frame, in its Parquet files (versions 2.1 and 3.0).

The user states the column: its name follows no convention. 42 numbers are 21 landmarks in the image (pixels, or
fractions of its sides), 63 are 21 joints before the clip's camera [m]; 84 and 126 are both hands. The first hand is
found by the names of the column's numbers (``meta/info.json``), by the hand's masks, or by the fit of the joints. The
joints are in MediaPipe's order, which is OpenPose's. Rows are matched to frames by their times where the rates differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip.clip import frame_indices
from getagrip.clip.match_frames import number_of
from getagrip.errors import InputError, MissingOptionError, UsageError, unknown_choice_error
from getagrip.geometry.camera import project
from getagrip.hands.model import Side
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.options import one_of
from getagrip.readers.streams import parquet_columns, read_columns
from getagrip.readers.trackers.estimates import OPPOSITE_SIDE, Estimates, Request
from getagrip.readers.trackers.joints import joint_estimates
from getagrip.readers.trackers.landmarks_2d import MAX_NORMALISED_COORDINATE, lift_image_landmarks
from getagrip.readers.trackers.read_hands import (
    CERTAIN_MISFIT_RATIO,
    N_ORDER_TEST_FRAMES,
    fraction_in_mask,
    joint_misfit,
)
from getagrip.readers.trackers.records import Sample
from getagrip.readers.trackers.tracker import Tracker, frames_of_images

Halves = Literal["left-first", "right-first"]
EXPECTED_JOINT_COUNTS = "42, 63, 84 or 126 numbers in each row"


@dataclass(frozen=True)
class LeRobot(Tracker):
    """A column of joints in a dataset of LeRobot. The column is required."""

    name = "LeRobot"
    takes = "a column of joints or landmarks in its Parquet files"
    looks_for = "data/*/*.parquet"
    layouts = ("data/chunk-*/*.parquet", "chunk-*/*.parquet", "*.parquet")

    column: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """Column of the hand's numbers."""
    episode: Annotated[int, arg(metavar="N")] = 0
    """Episode of the dataset."""
    halves: Annotated[Halves | None, one_of(*get_args(Halves)), arg(help_behavior_hint="")] = None
    """Which hand is in the first half of a column of both hands, where the dataset does not say."""

    def recognises(self, sample: Sample) -> str:
        other = sample.path.name == "hand_tracking.parquet"  # EgoHandKit's
        return "a dataset of LeRobot" if sample.path.suffix.lower() == ".parquet" and not other else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand in the clip's frames."""
        path, values, stamps = self._episode(paths)
        info = _read_dataset_info(path)
        frames, matched = _match_rows_to_frames(path, len(values), stamps, info.get("fps"), request)
        said = [matched]
        if values.shape[1] in (84, 126):
            first, why = self._first_half(path, values, frames, info, request)
            said.append(f"the {first} hand first, {why}")
            values = np.split(values, 2, axis=1)[int(first != request.side)]
        elif self.halves is not None:
            raise UsageError(f"--halves cannot be used with {path}: {self.column} has one hand")
        there = np.isfinite(values).all(axis=1) & (values != 0.0).any(axis=1)
        found = self._estimates(path, values, frames, there, request)
        return replace(found, scale="; ".join(filter(None, [found.scale, *said])))

    def _estimates(
        self, path: Path, values: Float[ndarray, "T n"], frames: Sequence[int | None], there: Bool[ndarray, "T"],
        request: Request,
    ) -> Estimates:  # fmt: skip
        if values.shape[1] == 42:
            seen = np.zeros((len(request.frames), 21, 4))
            for row, frame in enumerate(frames):
                if frame is not None and there[row]:
                    seen[frame] = np.column_stack([values[row].reshape(21, 2), np.ones(21), np.full(21, np.nan)])
            return lift_image_landmarks(path, seen, request)
        named = {"frames": [request.frames[n] for row, n in enumerate(frames) if n is not None and there[row]]}
        rows = [row for row, n in enumerate(frames) if n is not None and there[row]]
        if not rows:
            return Estimates(request.side, ())
        return joint_estimates(path, named, values[rows].reshape(-1, 21, 3), "openpose", request)

    def _first_half(
        self, path: Path, values: Float[ndarray, "T n"], frames: Sequence[int | None], info: Json, request: Request
    ) -> tuple[Side, str]:
        """Return the side of the first half, and the reason. Raises ``MissingOptionError`` for unknown sides."""
        if self.halves is not None:
            return "left" if self.halves == "left-first" else "right", "as stated"
        features = info.get("features")
        feature = features.get(self.column) if isinstance(features, dict) else None
        names = str(feature.get("names") if isinstance(feature, dict) else "").lower()
        left, right = names.find("left"), names.find("right")
        if min(left, right) >= 0:
            return "left" if left < right else "right", "as its numbers are named"
        halves, other = np.split(values, 2, axis=1), OPPOSITE_SIDE[request.side]
        shares = [_share_in_masks(half, frames, request) for half in halves]
        if abs(shares[0] - shares[1]) > MIN_HALVES_MASK_MARGIN:
            return request.side if shares[0] > shares[1] else other, "by the hand's masks"
        if values.shape[1] == 126:
            sides = OPPOSITE_SIDE.items()
            off = {side: _side_misfit(halves[0], side) + _side_misfit(halves[1], other) for side, other in sides}
            first = min(off, key=lambda side: off[side])
            if off[first] < CERTAIN_MISFIT_RATIO * off[OPPOSITE_SIDE[first]]:
                return first, "by which hand fits"
        missing = "missing --halves left-first or right-first"
        raise MissingOptionError(f"{path}: {missing}: which hand is first in {self.column} is not named")

    def _episode(self, paths: Sequence[Path]) -> tuple[Path, Float[ndarray, "T n"], Float[ndarray, "T"] | None]:
        """Read the column of the episode, from the first file that has it, and the times of its rows [s], if known."""
        columns = list[str]()
        for path in paths:
            columns = parquet_columns(path)
            if self.column is None or self.column not in columns:
                continue
            if LEROBOT_INDEX_COLUMNS[0] not in columns:
                continue
            others = [name for name in (*LEROBOT_INDEX_COLUMNS, *LEROBOT_TIME_COLUMNS) if name in columns]
            table = read_columns(path, [self.column, *others], (LEROBOT_INDEX_COLUMNS[0], self.episode))
            values = table[self.column]
            if len(values):
                if values.ndim != 2 or values.shape[1] not in (42, 63, 84, 126):
                    raise InputError(path, self.column, f"the shape {values.shape}", EXPECTED_JOINT_COUNTS)
                return path, values, _read_row_times(path, table)
        if self.column is None:
            raise MissingOptionError(f"missing --column: the hand's numbers; choose from {', '.join(columns)}")
        if self.column not in columns:
            raise unknown_choice_error("--column", self.column, columns)
        got = f"no row of episode {self.episode}"
        raise InputError(paths[0], LEROBOT_INDEX_COLUMNS[0], got, "an episode of the dataset")


LEROBOT_INDEX_COLUMNS = ("episode_index", "frame_index")
LEROBOT_TIME_COLUMNS = ("time_s", "timestamp")
"""Columns of the time of each row [s], the true time first: LeRobot's own column assumes an even rate."""
MIN_HALVES_MASK_MARGIN = 0.2
"""Minimum difference of two hands' fractions of points in the masks by which the masks decide."""
FRAME_RATE_TOLERANCE = 0.02
"""Maximum relative difference of equal frame rates."""


def _read_dataset_info(path: Path) -> Json:
    """Read the description of a file's dataset; empty without ``meta/info.json``. Raises ``InputError``."""
    for folder in list(path.absolute().parents)[:3]:
        if (folder / "meta" / "info.json").is_file():
            return files.read_json(files.inside(folder, "meta/info.json", "", "the dataset's description"))
    return {}


def _read_row_times(path: Path, table: Mapping[str, Float[ndarray, "T *n"]]) -> Float[ndarray, "T"] | None:
    """Return the times of an episode's rows, from the first one [s]; None without a column of times."""
    name = next((name for name in LEROBOT_TIME_COLUMNS if name in table), None)
    if name is None:
        return None
    values = table[name]
    if values.ndim != 1 or not np.isfinite(values).all() or (np.diff(values) <= 0.0).any():
        raise InputError(path, name, "times that do not rise", "the time of each row [s], later in each")
    return values - values[0]


def _match_rows_to_frames(
    path: Path, count: int, stamps: Float[ndarray, "T"] | None, fps: object, request: Request
) -> tuple[Sequence[int | None], str]:
    """Return the frame index of each row, and a note on the matching: by times where the rates differ.

    Raises ``UsageError`` where the row of the first frame is unknown.
    """
    times = request.times
    if stamps is None and isinstance(fps, int | float) and fps > 0:
        stamps = np.arange(count) / fps
    if stamps is None or times is None or min(len(stamps), len(times)) < 2:
        return frames_of_images(path, {}, count, request), ""
    step, own = float(np.median(np.diff(stamps))), float(np.median(np.diff(times)))
    if abs(step / own - 1.0) < FRAME_RATE_TOLERANCE:
        return frames_of_images(path, {}, count, request), ""
    since, long = times - times[0], stamps[-1] + step
    first = number_of(request.frames[0])
    if request.counted:
        if first is None or first >= count:
            raise UsageError(f"--first must be the number of a row of {path}, 0 to {count - 1} (got {first})")
        begin = float(stamps[first])
    elif abs(long - since[-1] - own) < max(step, own):  # as long as the clip
        begin = 0.0
    elif first is not None and (begin := (first - 1) * own) >= 0.0 and begin + since[-1] < long + own:  # of the video
        pass
    else:
        got = f"{count} rows in {long:.4g} s for {len(times)} frames in {since[-1] + own:.4g} s"
        which = "--first N, the number of the first frame's row, counted from 0"
        raise UsageError(f"{path}: {got}: missing {which}")
    near = np.abs(stamps[:, None] - begin - since).argmin(axis=1)
    off = np.abs(stamps - begin - since[near])
    best = {int(n): int(np.flatnonzero(near == n)[off[near == n].argmin()]) for n in np.unique(near[off <= own / 2.0])}
    rows = {row: n for n, row in best.items()}
    said = f"{1 / step:.3g} rows a second, {1 / own:.3g} frames per second: matched by timestamp"
    return [rows.get(row) for row in range(count)], said


def _side_misfit(values: Float[ndarray, "T 63"], side: Side) -> float:
    """Measure the misfit of joints to a hand of a side [m], in some of the rows with joints; 0 without any."""
    there = values[np.isfinite(values).all(axis=1) & (values != 0.0).any(axis=1)]
    some = there[frame_indices(len(there), N_ORDER_TEST_FRAMES)] if len(there) else there
    return joint_misfit(some.reshape(-1, 21, 3), "openpose", side) if len(some) else 0.0


def _share_in_masks(values: Float[ndarray, "T n"], frames: Sequence[int | None], request: Request) -> float:
    """Measure the fraction of a hand's points in the hand masks, in some frames; 0 without masks."""
    if not request.hand_masks:
        return 0.0
    there = [(row, n) for row, n in enumerate(frames) if n is not None and request.hand_masks[n] is not None]
    inside = []
    for row, n in [there[k] for k in frame_indices(len(there), N_ORDER_TEST_FRAMES)]:
        points = values[row].reshape(21, -1)
        if points.shape[1] == 3:
            points = project(request.K[n], np.where(points[:, 2:] > 0.0, points, [0.0, 0.0, 1.0]))
        elif np.abs(points).max() <= MAX_NORMALISED_COORDINATE:
            points = points * request.size
        path = request.hand_masks[n]
        assert path is not None
        inside.append(fraction_in_mask(path, np.clip(np.nan_to_num(points, nan=-1.0), -1, max(request.size)), request))
    return float(np.mean(inside)) if inside else 0.0
