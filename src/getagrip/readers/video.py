"""A stretch of a video, frame by frame, each once and in the order in which they are shown.

Frames are counted from 1 by decoding them from the beginning: no seeking, which is off by frames in many files.

The footage that a clip is cut from: a video, or a folder of images of which each is a frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip.match_frames import single_image_set
from getagrip.clip.read import MAX_CLIP_IMAGE_PIXELS, MAX_CLIP_SIDE_PX
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.images import decode_image
from getagrip.io.terminal import format_count
from getagrip.provenance import Source, assumed

if TYPE_CHECKING:
    from fractions import Fraction

    from av import VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

VIDEO_FORMATS = "mov,mp4,matroska,webm,avi,mpegts,gif"
"""Containers that are read. Not playlists, which can name other files."""


@dataclass(frozen=True)
class VideoInfo:
    """The properties of a video, known before its frames are decoded.

    Attributes:
        path: the video file.
        fps: frames per second.
        size: width and height as shown [px]; an upright video of a telephone is stored rotated, and some have pixels
            that are not square.
    """

    path: Path
    fps: float
    size: tuple[int, int]


def video_info(path: Path) -> VideoInfo:
    """Read the rate and size of a video, from its first frame. Raises ``InputError``."""
    first = next(_decode_frames(path), None)
    if first is None:
        raise InputError(path, "", "no frames", "a video")
    image, fps = first
    return VideoInfo(path, fps, (image.shape[1], image.shape[0]))


def video_frames(path: Path, first: int, last: int) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """Decode the RGB images of the frames ``first`` to ``last``, both included, counted from 1.

    Raises ``InputError``.
    """
    n = 0
    for n, (image, _) in enumerate(_decode_frames(path), start=1):
        if n >= first:
            yield image
        if n == last:
            return
    raise InputError(path, "", format_count(n, "frame"), f"at least {last}, for the interval {first} to {last}")


def open_video(path: Path) -> InputContainer:
    """Open a video file such that nothing in it can open another file. Raises ``InputError``."""
    import av
    from av.error import FFmpegError

    if path.is_dir():
        raise InputError(path, "", "a folder", "a video")
    if not path.is_file():
        raise InputError(path, "", "no such file", "a video")
    options = {"protocol_whitelist": "file", "format_whitelist": VIDEO_FORMATS}
    try:
        container = av.open(f"file:{path.resolve()}", options=options)
        stream = container.streams.video[0]
    except (FFmpegError, IndexError, OSError, ValueError) as error:
        allowed = f"a video ({VIDEO_FORMATS.replace(',', ', ')})"
        raise InputError(path, "", f"a file that does not decode as video ({error})", allowed) from error
    if stream.codec_context is None:
        raise InputError(path, "", "a stream of an unknown kind", "a video")
    width, height = max(stream.width, square_pixel_width(stream, stream.sample_aspect_ratio)), stream.height
    if not _is_allowed_size(width, height):
        raise InputError(path, "size", f"{width} x {height} pixels", f"at most {MAX_CLIP_IMAGE_PIXELS / 1e6:g} million")
    stream.codec_context.options = {
        "max_pixels": str(MAX_CLIP_IMAGE_PIXELS)
    }  # of later frames, which may have another size
    stream.thread_type = "AUTO"
    return container


def frame_times(path: Path) -> Float[ndarray, "N"] | None:
    """Read the time at which each frame is shown, from the first one [s]; None where the file does not say.

    Raises ``InputError``.

    The file is read through without decoding.
    """
    from av.error import FFmpegError

    with open_video(path) as container:
        stream = container.streams.video[0]
        try:
            packets = [packet for packet in container.demux(stream) if packet.size and not packet.is_discard]
        except (FFmpegError, OSError, ValueError) as error:
            raise InputError(path, "", f"a file that does not decode as video ({error})", "a video") from error
        ticks = [packet.pts for packet in packets if packet.pts is not None]
        base = stream.time_base
    if not ticks or len(set(ticks)) < len(packets) or base is None:
        return None
    return np.array([float((tick - min(ticks)) * base) for tick in sorted(ticks)])


def square_pixel_width(frame: VideoFrame | VideoStream, aspect: Fraction | None) -> int:
    """Return the width at which the pixels of a frame are square [px], before it is turned."""
    return max(1, round(frame.width * aspect)) if aspect else frame.width


def _is_allowed_size(width: int, height: int) -> bool:
    return 0 < max(width, height) <= MAX_CLIP_SIDE_PX and width * height <= MAX_CLIP_IMAGE_PIXELS


def frame_to_rgb(frame: VideoFrame, aspect: Fraction | None) -> UInt8[ndarray, "H W 3"]:
    """Return the RGB image of a frame as shown. Raises ``ValueError`` for one that is too large.

    Pixels that are stored ``aspect`` times as wide as high become square.
    """
    width = square_pixel_width(frame, aspect)
    if not _is_allowed_size(width, frame.height):
        raise ValueError(f"a frame of {width} x {frame.height} pixels")
    wide = frame if width == frame.width else frame.reformat(width=width, height=frame.height)
    return np.rot90(np.asarray(wide.to_ndarray(format="rgb24"), np.uint8), round(frame.rotation / 90.0))


def _decode_frames(path: Path) -> Iterator[tuple[UInt8[ndarray, "H W 3"], float]]:
    """All frames, and the frames per second."""
    from av.error import FFmpegError

    with open_video(path) as container:
        stream = container.streams.video[0]
        fps = float(stream.average_rate or 30)
        try:
            for frame in container.decode(stream):
                yield frame_to_rgb(frame, stream.sample_aspect_ratio), fps
        except (FFmpegError, OSError, ValueError) as error:
            raise InputError(path, "", f"a file that does not decode as video ({error})", "a video") from error


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
