"""Footage of a further camera, its frames matched to those of a clip.

Images of two folders are matched by the numbers in their names. Frames of videos have the same numbers if the times of
all of them agree; else, or with a stated start, the nearest frame in time is taken. A frame of a clip has no image of
the other camera if the nearest one is more than half a frame away.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip.match_frames import number_of
from getagrip.errors import InputError
from getagrip.io.terminal import format_count
from getagrip.readers.footage import Footage, ImageFolder, VideoFootage
from getagrip.readers.video import FootageInterval

IN_STEP_S = 1e-3
"""Difference of times up to which cameras are in step [s]."""
HALF_FRAME_TOLERANCE = 0.01
"""Part of a frame by which a nearest image may be more than half a frame away: times are rounded."""

MIN_MATCHED_FRAMES = 2
"""Least number of frames of a view."""


@dataclass(frozen=True, eq=False)
class MatchedFootage:
    """The images of a further camera, for n of the frames of a clip.

    Attributes:
        footage: the other camera's.
        known: (n,) rows of the clip's frames that have an image.
        at: (n,) indices of their images.
        off: (n,) times of the images after the clip's [s]; zeros if matched by number.
        frame_s: time between two frames of the clip [s].
        by: ``number`` or ``time``.
    """

    footage: Footage
    known: Int[ndarray, "n"]
    at: Int[ndarray, "n"]
    off: Float[ndarray, "n"]
    frame_s: float
    by: str

    @property
    def time_offset(self) -> float:
        """Median time of the images after the clip's [s]; 0 for cameras in step."""
        middle = float(np.median(self.off))
        return round(middle, 6) if abs(middle) > IN_STEP_S else 0.0

    @property
    def words(self) -> str:
        """Description of the match, for its provenance."""
        most = float(np.abs(self.off).max())
        apart = f", up to {1e3 * most:.0f} ms apart ({most / self.frame_s:.2f} of a frame)" if most > IN_STEP_S else ""
        return f"frames matched by {self.by}{apart}"

    def images(self) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """Yield the image of each known frame. Raises ``InputError``, also for one of another size."""
        size = self.footage.size
        for n in self.at.tolist():
            image = self.footage.image(n)
            if image.shape[1::-1] != size:
                got = f"{image.shape[1]} x {image.shape[0]} pixels"
                raise InputError(Path(self.footage.name(n)), "size", got, f"{size[0]} x {size[1]}, as the first frame")
            yield image


def match_footage(clip: FootageInterval, path: Path, start: float | None = None) -> MatchedFootage:
    """Match the footage of a further camera, a video or a folder of images, to the frames of a clip.

    ``start`` is the time in this footage at time 0 of the clip's [s]. Raises ``InputError`` where fewer than two
    frames match.
    """
    footage: Footage = replace(ImageFolder.open(path), fps=clip.fps) if path.is_dir() else VideoFootage(path)
    frame_s = float(np.median(np.diff(clip.times)))
    times = np.array([footage.time(n) for n in range(footage.frames)])
    by_number = {} if start is not None else _rows_by_number(clip, footage, times, frame_s)
    if len(by_number) >= MIN_MATCHED_FRAMES:
        known, at = (np.array(each, dtype=np.int64) for each in zip(*by_number.items(), strict=True))
        return MatchedFootage(footage, known, at, np.zeros(len(known)), frame_s, "number")
    wanted = clip.times + (start or 0.0)
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    pair = np.stack([after - 1, np.minimum(after, len(times) - 1)])
    nearest = np.where(np.abs(times[pair[0]] - wanted) <= np.abs(times[pair[1]] - wanted), *pair)
    off = times[nearest] - wanted
    known = np.flatnonzero(np.abs(off) <= (0.5 + HALF_FRAME_TOLERANCE) * frame_s)
    if len(known) < MIN_MATCHED_FRAMES:
        got = f"frames from {times[0]:.3g} to {times[-1]:.3g} s"
        expected = f"some at the clip's times, {wanted[0]:.3g} to {wanted[-1]:.3g} s; --view-start states when it began"
        raise InputError(path, "", got, expected)
    return MatchedFootage(footage, known, nearest[known], off[known], frame_s, "time")


def _rows_by_number(
    clip: FootageInterval, footage: Footage, times: Float[ndarray, "N"], frame_s: float
) -> dict[int, int]:
    """Return the image of each of the clip's frames by number; none if numbers do not say it."""
    if isinstance(footage, ImageFolder) and clip.path.is_dir():
        place = {number: n for n, number in enumerate(footage.numbers)}
        numbers = [number_of(name) for name in clip.names]
        return {row: place[number] for row, number in enumerate(numbers) if number in place}
    last = clip.first - 1 + len(clip.names)
    if isinstance(footage, ImageFolder) or clip.path.is_dir() or len(times) < last:
        return {}
    off = times[clip.first - 1 : last] - clip.times
    return {row: clip.first - 1 + row for row in range(len(off))} if np.abs(off).max() < 0.5 * frame_s else {}


def describe_match(name: str, match: MatchedFootage, frames: int) -> str:
    """Describe what a view has of a clip's frames."""
    some = f"{len(match.known)} of {format_count(frames, 'frame')}"
    return f"view {name}: {some}, {match.words}"
