"""The footage that a clip is cut from: a video, or a folder of images of which each is a frame."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip.naming import single_image_set
from getagrip.clip.reading import MAX_CLIP_SIDE_PX
from getagrip.clip.video import frame_times, video_frames, video_info
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.images import decode_image
from getagrip.provenance import Source, assumed

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_FRAME_FILE_BYTES = 64 * 2**20
"""Bytes of an image's file."""
FOLDER_FPS = 30.0
"""Assumed frame rate of images in a folder."""
FRAME_TIME_TOLERANCE_S = 0.003
"""Times that are off the average rate's by no more are even [s]."""


@dataclass(frozen=True)
class FootageInterval:
    """Some frames of a video or folder.

    Attributes:
        names: of the frames, as clips have them.
        times: when each is shown, from the beginning of the footage [s].
        fps: frames per second.
        size: width and height as shown [px].
        rate: where ``fps`` comes from, where that is a guess.
        chosen: pattern of the images' names, where a folder has several sets of them.
    """

    path: Path
    first: int
    names: tuple[str, ...]
    times: Float[ndarray, "T"]
    fps: float
    size: tuple[int, int]
    rate: Source | None = None
    chosen: str = ""

    def images(self) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """Yield RGB images, one by one. Raises ``InputError`` where one has another size."""
        last = self.first + len(self.names) - 1
        shown: Iterable[UInt8[ndarray, "H W 3"]] = (
            map(_read_frame_image, list_frame_images(self.path, self.chosen)[self.first - 1 : last])
            if self.path.is_dir()
            else video_frames(self.path, self.first, last)
        )
        for name, image in zip(self.names, shown, strict=True):
            if image.shape[1::-1] != self.size:
                got = f"{image.shape[1]} x {image.shape[0]} pixels in frame {files.printable(name)}"
                raise InputError(self.path, "size", got, "{} x {}, as the first frame has".format(*self.size))
            yield image


def size_and_rate(path: Path, fps: float | None, chosen: str = "") -> tuple[tuple[int, int], float]:
    """Return width and height [px], and frames per second: as stated, else as the file says. Raises ``InputError``."""
    if fps is not None and not 0.1 <= fps <= 10_000.0:
        raise UsageError(f"--fps must be 0.1 to 10000 frames per second (got {fps:g})")
    if path.is_dir():
        height, width = _read_frame_image(list_frame_images(path, chosen)[0]).shape[:2]
        return (width, height), fps or FOLDER_FPS
    if chosen:
        raise UsageError("--images cannot be used with a video; it is for folders of images")
    if fps is not None:
        raise UsageError("--fps cannot be used with a video, whose frames have times; it is for folders of images")
    info = video_info(path)
    return info.size, info.fps


def footage_interval(
    path: Path, numbers: Int[ndarray, "T"], size: tuple[int, int], fps: float, stated: bool, chosen: str = ""
) -> FootageInterval:
    """Return the frames of these numbers, counted from 1. Raises ``InputError`` where there are fewer."""
    first, last = int(numbers[0]), int(numbers[-1])
    if path.is_dir():
        paths = list_frame_images(path, chosen)
        if len(paths) < last:
            raise InputError(path, "", f"{len(paths)} images", f"at least {last}, for the interval {first} to {last}")
        names = tuple(each.stem for each in paths[first - 1 : last])
        rate = None if stated else assumed(f"a guess: {fps:g} frames per second; --fps states it")
        return FootageInterval(path, first, names, (numbers - 1) / fps, fps, size, rate, chosen)
    times = frame_times(path)
    shown = (numbers - 1) / fps if times is None or len(times) < last else times[first - 1 : last]
    if np.abs(shown - shown[0] - (numbers - first) / fps).max() > FRAME_TIME_TOLERANCE_S:
        fps = 1.0 / float(np.median(np.diff(shown)))
    return FootageInterval(path, first, tuple(f"{n:06d}" for n in numbers), shown, fps, size)


def list_frame_images(folder: Path, chosen: str = "", option: str = "--images") -> Sequence[Path]:
    """List the images of a folder, in the order of the numbers in their names; those ``chosen`` by a pattern.

    Raises ``InputError`` where there is none, and for several sets of images (``naming.one_set``), among which the
    command's ``option`` chooses.
    """
    paths = files.list_files(folder, IMAGE_SUFFIXES)
    if not paths:
        raise InputError(folder, "", "no images in it", f"a video, or a folder of images ({', '.join(IMAGE_SUFFIXES)})")
    return sorted(
        single_image_set(folder, paths, chosen, option), key=lambda path: (_natural_sort_key(path.stem), path.name)
    )


def _natural_sort_key(name: str) -> list[tuple[int, str]]:
    """Numbers in a name count as numbers: frame9 is before frame10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name) if part]


def _read_frame_image(path: Path) -> UInt8[ndarray, "H W 3"]:
    return decode_image(path, "", files.read_bytes(path, MAX_FRAME_FILE_BYTES), MAX_CLIP_SIDE_PX)
