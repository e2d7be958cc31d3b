"""The frames of a video by index, exactly: decoded from the key frame before, and recognised by their times."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Generic, TypeVar

from getagrip.annotate.footage import CACHE, Cache
from getagrip.clip.video import open_video
from getagrip.errors import InputError

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

BEHIND = 48
"""Number of frames before a requested one that are kept, since they have been decoded: for steps back."""
Kept = TypeVar("Kept")


class Decoder(Generic[Kept]):
    """Gives frames in some form, and keeps those that were asked for last."""

    def __init__(
        self,
        path: Path,
        times: Sequence[int],
        keys: Sequence[int],
        convert: Callable[[VideoFrame], Kept],
        weigh: Callable[[Kept], int],
        limit: int = CACHE,
    ) -> None:
        """Decode a file whose frames, and key frames, have these presentation times; ``limit`` bytes are kept."""
        self.path = path
        self._times, self._keys, self._convert = times, keys, convert
        self.cache = Cache(weigh, limit)
        self._lock = Lock()
        self._container: InputContainer | None = None
        self._decoded: Iterator[VideoFrame] = iter(())
        self._at = -1
        """Index of the frame decoded last."""

    def get(self, index: int) -> Kept:
        """Decode a frame. Raises ``InputError`` where it does not decode."""
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
            self._close()

    def _close(self) -> None:
        self._decoded, self._at = iter(()), -1
        if self._container is not None:
            self._container.close()
            self._container = None

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
                container = self._container = self._container or open_video(self.path)
                container.seek(self._keys[nearest - back], stream=container.streams.video[0])
            else:
                self._close()
                container = self._container = open_video(self.path)
            self._decoded, self._at = container.decode(video=0), -1
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
            if at >= len(self._times) or self._times[at] != last:
                continue
            self._at = at
            if index - BEHIND < at <= index and self.cache.get(at) is None:
                self.cache.put(at, self._convert(frame))
            if at >= index:
                return at == index
        self._decoded, self._at = iter(()), -1
        return False
