"""Frames by index, as JPEG: what the page shows. Of a video (``video``), or of a folder of images."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar, overload

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip.naming import single_image_set
from getagrip.errors import InputError
from getagrip.io.files import list_files, read_bytes
from getagrip.io.images import decode_image

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_DISPLAY_WIDTH_PX = 1280
"""Images are sent at most so wide [px]."""
MAX_FOOTAGE_SIDE_PX = 8192
"""Limit of the sides of what is read [px]."""
MAX_FRAME_FILE_BYTES = 64 * 2**20
"""Limit in bytes of an image's file."""
MAX_FOOTAGE_FRAMES = 2_000_000
"""No footage is longer: eleven hours at 50 frames per second."""
FOLDER_FPS = 30.0
"""Frames per second that images in a folder are played at."""
FOOTAGE_JPEG_QUALITY = 88
"""Quality of the JPEG images."""
JPEG_CACHE_BYTES = 64 * 2**20
"""Bytes of JPEG images that are kept of one footage."""


class Footage(Protocol):
    """Frames 0 .. N-1 in the order they are shown in."""

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
        """Return the time at which a frame is shown, from the start [s]."""

    def number(self, index: int) -> int:
        """Return the number that the footage's own naming gives a frame."""

    def index(self, number: int) -> int:
        """Return the frame of a number, the nearest where it has none."""

    def name(self, index: int) -> str:
        """Return a frame's name in a clip of the footage."""

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        """Return a frame for display, ``whole`` or made smaller where it is wide. Raises ``InputError``."""

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        """Return a frame, all of its pixels: red, green, blue. Raises ``InputError`` where it does not decode."""

    def close(self) -> None:
        """Close the files, until a frame is asked for again."""


def duration_seconds(footage: Footage, start: int, end: int) -> float:
    """Return the duration of frames ``start`` to ``end``, the last one included [s]."""
    return footage.time(end) - footage.time(start) + 1.0 / footage.fps


class FrameNames(Sequence[str]):
    """The names of footage's frames in clips; made when they are asked for, since footage may be hours long."""

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


CachedImage = TypeVar("CachedImage")


@dataclass
class ImageCache(Generic[CachedImage]):
    """The images that were requested last, up to a number of bytes in all."""

    weigh: Callable[[CachedImage], int]
    """The bytes of an image."""
    limit: int = JPEG_CACHE_BYTES
    cached_bytes: int = 0
    images: OrderedDict[int, CachedImage] = field(default_factory=OrderedDict)

    def get(self, index: int) -> CachedImage | None:
        """Return an image, if it is there."""
        if index in self.images:
            self.images.move_to_end(index)
        return self.images.get(index)

    def put(self, index: int, image: CachedImage) -> None:
        """Keep an image, and drop those that have not been asked for the longest."""
        if index in self.images:
            self.cached_bytes -= self.weigh(self.images.pop(index))
        self.cached_bytes += self.weigh(image)
        self.images[index] = image
        while self.cached_bytes > self.limit and len(self.images) > 1:
            _, old = self.images.popitem(last=False)
            self.cached_bytes -= self.weigh(old)


@dataclass(frozen=True)
class ImageFolder:
    """Images of a folder, in the order of the numbers that their names end in; by name where not all have one."""

    paths: tuple[Path, ...]
    numbers: tuple[int, ...]
    fps: float = FOLDER_FPS

    @staticmethod
    def open(folder: Path) -> ImageFolder:
        """Open the images of a folder. Raises ``InputError`` where there is none."""
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
        """Number of images."""
        return len(self.paths)

    def time(self, index: int) -> float:
        """Return the time at which an image is shown [s]: by its number, so that gaps count."""
        return (self.numbers[index] - self.numbers[0]) / self.fps

    def number(self, index: int) -> int:
        """Return the number in the image's name, or its place from 1."""
        return self.numbers[index]

    def index(self, number: int) -> int:
        """Return the image of a number, or the nearest to it."""
        return int(np.argmin(np.abs(np.array(self.numbers) - number)))

    def name(self, index: int) -> str:
        """Return the image's name, as of the images of a clip."""
        return self.paths[index].stem

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first image [px]. Raises ``InputError`` where it does not decode."""
        height, width = self._bgr(0).shape[:2]
        return width, height

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        """Return an image, as JPEG whatever its file is. Raises ``InputError``."""
        return encode_footage_jpeg(self._bgr(index), MAX_FOOTAGE_SIDE_PX if whole else MAX_DISPLAY_WIDTH_PX)

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        """Return an image, all of its pixels. Raises ``InputError``."""
        return np.ascontiguousarray(self._bgr(index)[..., ::-1])

    def close(self) -> None:
        """Do nothing: no file is kept open."""

    def _bgr(self, index: int) -> UInt8[ndarray, "H W 3"]:
        path = self.paths[index]
        image = decode_image(path, "", read_bytes(path, MAX_FRAME_FILE_BYTES), MAX_FOOTAGE_SIDE_PX)
        return np.ascontiguousarray(image[..., ::-1])


def encode_footage_jpeg(bgr: UInt8[ndarray, "H W 3"], widest: int = MAX_DISPLAY_WIDTH_PX) -> bytes:
    """Encode an image as JPEG, made narrower where it is too wide."""
    import cv2

    height, width = bgr.shape[:2]
    if width > widest:
        size = widest, max(1, round(height * widest / width))
        bgr = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, content = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, FOOTAGE_JPEG_QUALITY])
    return bytes(content.tobytes())
