"""The frames of a video file by index, exactly: every frame has its place in the order of presentation times.

The file is read through once without decoding, for the times of all its frames. A frame is then found by decoding from
the key frame before it, and recognised by its time, not by counting: so B-frames, start times other than zero and
uneven rates do not matter.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from getagrip.annotate.footage import MOST_FRAMES, WIDEST, Cache, encoded
from getagrip.clip.video import open_video
from getagrip.datasets.epic_files import VIDEO, numbering_rate
from getagrip.errors import InputError

if TYPE_CHECKING:
    from av import VideoFrame

SUFFIXES = (".mp4", ".MP4", ".mov", ".MOV", ".m4v", ".mkv", ".webm", ".avi")
BEHIND = 48
"""So many frames before one that is asked for are kept as well, since they have been decoded: for steps back."""


class Video:
    """A video file. Frames are numbered as EPIC-KITCHENS does where its name is one of theirs, else from 1."""

    def __init__(self, path: Path) -> None:
        """Read the times of all frames. Raises ``InputError`` for what is no video."""
        from av.error import FFmpegError

        self.path = path
        self.cache = Cache()
        self._lock = Lock()
        self._decoded: Iterator[VideoFrame] = iter(())
        self._at = -1
        """Index of the frame decoded last."""
        try:
            self._container = open_video(path)
            stream = self._container.streams.video[0]
            self._base = Fraction(stream.time_base or Fraction(1, 90_000))
            self._times, self._keys = self._read_times(path)
            self._begin = self._times[0] if stream.start_time is None else stream.start_time
            span = (self._times[-1] - self._times[0]) * self._base
            self.fps = float((self.frames - 1) / span) if span else float(stream.average_rate or 30)
        except (FFmpegError, IndexError, OSError, ValueError) as error:
            raise InputError(path, "", f"a file that is no video ({error})", "a video") from error
        self._rate = numbering_rate(path.stem) if VIDEO.fullmatch(path.stem) else None

    def _read_times(self, path: Path) -> tuple[list[int], list[int]]:
        """Presentation times of all frames and of the key frames, rising, in units of the stream's time base."""
        times, keys = set(), set()
        with open_video(self.path) as container:
            for packet in container.demux(container.streams.video[0]):
                if packet.size == 0 or packet.is_discard:
                    continue
                if packet.pts is None:
                    raise InputError(path, "", "frames without times", "a video whose frames have times, as an .mp4")
                times.add(packet.pts)
                if packet.is_keyframe:
                    keys.add(packet.pts)
                if len(times) > MOST_FRAMES:
                    raise InputError(path, "", f"more than {MOST_FRAMES} frames", "a shorter video")
        if not times or not keys:
            raise InputError(path, "", "no frames", "a video")
        return sorted(times), sorted(keys)

    @property
    def frames(self) -> int:
        """How many frames the file has."""
        return len(self._times)

    def time(self, index: int) -> float:
        """When a frame is shown, from the start of the stream [s]."""
        return float(self._time(index))

    def _time(self, index: int) -> Fraction:
        return (self._times[index] - self._begin) * self._base

    def number(self, index: int) -> int:
        """EPIC's number of a frame in one of its videos, else its place from 1."""
        return index + 1 if self._rate is None else round(self._time(index) * Fraction(self._rate)) + 1

    def index(self, number: int) -> int:
        """The frame of a number, as the reader of EPIC-Grasps finds it; the nearest where there is none."""
        if self._rate is None:
            found = number - 1
        else:
            half = Fraction(1, 2) / Fraction(self.fps).limit_denominator(100_000)
            wanted = (number - 1) / Fraction(self._rate) - half
            found = bisect_left(range(self.frames), wanted, key=self._time)
        return min(max(found, 0), self.frames - 1)

    def jpeg(self, index: int) -> bytes:
        """A frame. Raises ``InputError`` where it does not decode."""
        from av.error import FFmpegError

        with self._lock:
            if (kept := self.cache.get(index)) is not None:
                return kept
            try:
                self._decode(index)
            except (FFmpegError, OSError, ValueError) as error:
                self._decoded, self._at = iter(()), -1
                raise InputError(self.path, f"frame {index}", f"nothing that decodes ({error})", "a frame") from error
            image = self.cache.get(index)
            if image is None:
                raise InputError(self.path, f"frame {index}", "nothing that decodes", "a frame")
            return image

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._container.close()

    def _decode(self, index: int) -> None:
        """Decode up to a frame, and keep it and some of those before it."""
        nearest = max(0, bisect_right(self._keys, self._times[index]) - 1)
        key = self._keys[nearest]
        if 0 <= self._at < index and self._times[self._at] >= key:
            self._advance(index, key)
            return
        # Containers seek by decoding times, some only roughly: where a later frame came out, begin earlier, twice as
        # far each time, and at last at the very beginning.
        for back in (0, 1, 2, 4, 8, nearest + 1):
            if back <= nearest:
                self._container.seek(self._keys[nearest - back], stream=self._container.streams.video[0])
            else:
                self._container.close()
                self._container = open_video(self.path)
            self._decoded, self._at = self._container.decode(video=0), -1
            if self._advance(index, key):
                return

    def _advance(self, index: int, key: int) -> bool:
        """Decode on to a frame; whether it came. Frames before the key frame may be damaged and are passed over.

        Raises ``InputError`` where times are not in the order of the frames: AVI does not keep those of B-frames.
        """
        last = None
        for frame in self._decoded:
            if last is not None and (frame.pts is None or frame.pts <= last):
                expected = "frames in the order of their times: convert the video to .mp4"
                raise InputError(self.path, "", f"the time {frame.pts} after {last}", expected)
            last = frame.pts
            if last is None or last < key:
                continue
            at = bisect_left(self._times, last)
            if at >= self.frames or self._times[at] != last:
                continue
            self._at = at
            if index - BEHIND < at <= index and self.cache.get(at) is None:
                self.cache.put(at, _encoded(frame))
            if at >= index:
                return at == index
        self._decoded, self._at = iter(()), -1
        return False


def _encoded(frame: VideoFrame) -> bytes:
    """A frame as JPEG, upright, made smaller where it is too wide."""
    shrunk = min(1.0, WIDEST / frame.width)
    size = max(2, round(frame.width * shrunk)), max(2, round(frame.height * shrunk))
    image = frame.to_ndarray(format="bgr24", width=size[0], height=size[1])
    return encoded(np.ascontiguousarray(np.rot90(image, frame.rotation // 90), np.uint8))
