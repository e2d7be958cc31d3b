"""Footage: the frames of a video or of a folder of images by index, as arrays, and as JPEG for a page."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, overload

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip.match_frames import single_image_set
from getagrip.errors import InputError
from getagrip.io.files import list_files, read_bytes
from getagrip.io.images import decode_image
from getagrip.readers.datasets.epic.epic_tables import EPIC_VIDEO_PATTERN, numbering_rate
from getagrip.readers.video import (
    FOLDER_FPS,
    IMAGE_SUFFIXES,
    MAX_FRAME_FILE_BYTES,
    FrameDecoder,
    ImageCache,
    frame_to_bgr,
    frame_to_rgb,
    read_timing,
)

if TYPE_CHECKING:
    from av import VideoFrame

MAX_DISPLAY_WIDTH_PX = 1280
"""Maximum width of images for display [px]."""
MAX_FOOTAGE_SIDE_PX = 8192
"""Maximum side of an image file [px]."""
MAX_FOOTAGE_FRAMES = 2_000_000
"""Maximum number of frames: eleven hours at 50 frames per second."""
FOOTAGE_JPEG_QUALITY = 88
JPEG_CACHE_BYTES, IMAGE_CACHE_BYTES = 64 * 2**20, 64 * 2**20
"""Cache sizes of one video, for JPEG images and for whole images."""


class Footage(Protocol):
    """Frames 0 to N-1 in the order of presentation."""

    @property
    def frames(self) -> int:
        """Number of frames, N."""

    @property
    def fps(self) -> float:
        """Frames per second, on average."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames [px]."""

    def time(self, index: int) -> float:
        """Return the presentation time of a frame, from the start [s]."""

    def number(self, index: int) -> int:
        """Return a frame's number in the footage's own naming."""

    def index(self, number: int) -> int:
        """Return the frame of a number, or the nearest frame."""

    def name(self, index: int) -> str:
        """Return a frame's name in a clip of the footage."""

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        """Return a frame for display, ``whole`` or of a limited width. Raises ``InputError``."""

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        """Return the RGB image of a frame in full resolution. Raises ``InputError``."""

    def close(self) -> None:
        """Close the files until the next request."""


def duration_seconds(footage: Footage, start: int, end: int) -> float:
    """Return the duration of frames ``start`` to ``end``, both included [s]."""
    return footage.time(end) - footage.time(start) + 1.0 / footage.fps


class FrameNames(Sequence[str]):
    """The clip names of footage's frames, made on request, since footage may be hours long."""

    def __init__(self, footage: Footage) -> None:
        self.footage = footage

    def __len__(self) -> int:
        return self.footage.frames

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: int | slice) -> str | list[str]:
        if isinstance(index, slice):
            return [self.footage.name(n) for n in range(len(self))[index]]
        return self.footage.name(range(len(self))[index])


@dataclass(frozen=True)
class ImageFolder:
    """Images of a folder, by the numbers at the end of their names; by name if an image has no number."""

    paths: tuple[Path, ...]
    numbers: tuple[int, ...]
    fps: float = FOLDER_FPS

    @staticmethod
    def open(folder: Path) -> ImageFolder:
        """Open the images of a folder. Raises ``InputError`` without images."""
        paths = single_image_set(folder, list_files(folder, IMAGE_SUFFIXES))
        if not 0 < len(paths) <= MAX_FOOTAGE_FRAMES:
            raise InputError(folder, "", f"{len(paths)} images in it", f"images ({', '.join(IMAGE_SUFFIXES)})")
        ends = [re.search(r"([0-9]{1,9})$", path.stem) for path in paths]
        named = {int(end[1]): path for end, path in zip(ends, paths, strict=True) if end}
        if len(named) < len(paths):
            return ImageFolder(tuple(paths), tuple(range(1, len(paths) + 1)))
        numbers = tuple(sorted(named))
        return ImageFolder(tuple(named[number] for number in numbers), numbers)

    @property
    def frames(self) -> int:
        return len(self.paths)

    def time(self, index: int) -> float:
        """Return the time of an image by its number [s], so that gaps count."""
        return (self.numbers[index] - self.numbers[0]) / self.fps

    def number(self, index: int) -> int:
        """Return the number in the image's name, or the image's position from 1."""
        return self.numbers[index]

    def index(self, number: int) -> int:
        """Return the image of a number, or the nearest image."""
        return int(np.argmin(np.abs(np.array(self.numbers) - number)))

    def name(self, index: int) -> str:
        return self.paths[index].stem

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first image [px]. Raises ``InputError``."""
        height, width = self._bgr(0).shape[:2]
        return width, height

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        return encode_footage_jpeg(self._bgr(index), MAX_FOOTAGE_SIDE_PX if whole else MAX_DISPLAY_WIDTH_PX)

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        return np.ascontiguousarray(self._bgr(index)[..., ::-1])

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def _bgr(self, index: int) -> UInt8[ndarray, "H W 3"]:
        path = self.paths[index]
        image = decode_image(path, "", read_bytes(path, MAX_FRAME_FILE_BYTES), MAX_FOOTAGE_SIDE_PX)
        return np.ascontiguousarray(image[..., ::-1])


def encode_footage_jpeg(bgr: UInt8[ndarray, "H W 3"], widest: int = MAX_DISPLAY_WIDTH_PX) -> bytes:
    """Encode an image as JPEG of at most a width [px]."""
    import cv2

    height, width = bgr.shape[:2]
    if width > widest:
        size = widest, max(1, round(height * widest / width))
        bgr = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, content = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, FOOTAGE_JPEG_QUALITY])
    return bytes(content.tobytes())


class VideoFootage:
    """A video file. Frames have EPIC-KITCHENS' numbers in videos with EPIC's names, else numbers from 1."""

    def __init__(self, path: Path) -> None:
        """Read the times of all frames. Raises ``InputError`` for a file that is not a video."""
        timing = read_timing(path, MAX_FOOTAGE_FRAMES)
        if timing.untimed:
            raise InputError(path, "", "frames without times", "a video whose frames have times, as an .mp4")
        self._times, keys, aspect = sorted(set(timing.times)), timing.keys, timing.aspect
        if not self._times or not keys:
            raise InputError(path, "", "no frames", "a video")
        self._base = timing.base or Fraction(1, 90_000)
        self._begin = self._times[0] if timing.start is None else timing.start
        span = (self._times[-1] - self._times[0]) * self._base
        self.fps = float((self.frames - 1) / span) if span else float(timing.rate or 30)
        self._rate = numbering_rate(path.stem) if EPIC_VIDEO_PATTERN.fullmatch(path.stem) else None

        def as_jpeg(frame: VideoFrame) -> bytes:
            return encode_footage_jpeg(frame_to_bgr(frame, aspect, MAX_DISPLAY_WIDTH_PX))

        def as_rgb(frame: VideoFrame) -> UInt8[ndarray, "H W 3"]:
            return np.ascontiguousarray(frame_to_rgb(frame, aspect))

        jpegs = ImageCache[bytes](len, JPEG_CACHE_BYTES)
        images = ImageCache[UInt8[ndarray, "H W 3"]](lambda image: int(image.nbytes), IMAGE_CACHE_BYTES)
        self.shown = FrameDecoder(path, self._times, keys, as_jpeg, jpegs)
        self.whole = FrameDecoder(path, self._times, keys, as_rgb, images)

    @property
    def frames(self) -> int:
        return len(self._times)

    @cached_property
    def size(self) -> tuple[int, int]:
        height, width = self.image(0).shape[:2]
        return width, height

    def time(self, index: int) -> float:
        """Return the presentation time of a frame, from the start of the stream [s]."""
        return float(self._time(index))

    def _time(self, index: int) -> Fraction:
        return (self._times[index] - self._begin) * self._base

    def number(self, index: int) -> int:
        """Return EPIC's number of a frame in one of EPIC's videos, else its position from 1."""
        return index + 1 if self._rate is None else round(self._time(index) * Fraction(self._rate)) + 1

    def index(self, number: int) -> int:
        """Return the frame of a number, as the reader of EPIC-Grasps finds it, or the nearest frame."""
        if self._rate is None:
            found = number - 1
        else:
            half = Fraction(1, 2) / Fraction(self.fps).limit_denominator(100_000)
            wanted = (number - 1) / Fraction(self._rate) - half
            found = bisect_left(range(self.frames), wanted, key=self._time)
        return min(max(found, 0), self.frames - 1)

    def name(self, index: int) -> str:
        return f"{index + 1:06d}"

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        if not whole:
            return self.shown.get(index)
        return encode_footage_jpeg(self.image(index)[..., ::-1], MAX_FOOTAGE_SIDE_PX)

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        return self.whole.get(index)

    def close(self) -> None:
        self.shown.close()
        self.whole.close()
