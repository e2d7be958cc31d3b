"""A stretch of a video, frame by frame, each once and in the order in which they are shown.

Frames are counted from 1 by decoding them from the beginning: no seeking, which is off by frames in many files.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip.reading import MAX_CLIP_IMAGE_PIXELS, MAX_CLIP_SIDE_PX
from getagrip.errors import InputError
from getagrip.io.terminal import format_count

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
