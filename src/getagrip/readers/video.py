"""Videos: opened safely, decoded from the first frame on, at some times or by index; and the frames of a clip to be.

A frame is identified by its presentation time. ``video_frames`` counts frames from 1 by decoding all of them, without
seeking, which is off by frames in many files. ``FrameDecoder`` seeks, and finds a frame by its time rather than by
counting, so that B-frames, start times other than zero and uneven rates do not matter. ``FootageInterval`` is what a
clip is cut from: frames of a video, or images of a folder.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip.match_frames import single_image_set
from getagrip.clip.read import MAX_CLIP_IMAGE_PIXELS, MAX_CLIP_SIDE_PX
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.files import printable
from getagrip.io.images import decode_image
from getagrip.io.terminal import format_count
from getagrip.provenance import Source, assumed

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

VIDEO_FORMATS = "mov,mp4,matroska,webm,avi,mpegts,gif"
"""Containers to read; playlists are left out, since they can name other files."""
VIDEO_SUFFIXES = (".mp4", ".MP4", ".mov", ".MOV", ".m4v", ".mkv", ".webm", ".avi")
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_FRAME_FILE_BYTES = 64 * 2**20
"""Maximum size of an image file of a folder."""
FOLDER_FPS = 30.0
"""Assumed frame rate of the images of a folder."""
FRAME_TIME_TOLERANCE_S = 0.003
"""Maximum deviation of presentation times from an even rate [s]."""
N_CACHED_PREVIOUS_FRAMES = 48
"""Number of decoded frames before a requested one that are cached, for steps back."""

Converted = TypeVar("Converted")


def open_video(path: Path) -> InputContainer:
    """Open a video file such that nothing in it can open another file. Raises ``InputError``."""
    import av

    if path.is_dir():
        raise InputError(path, "", "a folder", "a video")
    if not path.is_file():
        raise InputError(path, "", "no such file", "a video")
    options = {"protocol_whitelist": "file", "format_whitelist": VIDEO_FORMATS}
    with _refuse_undecodable(path, f"a video ({VIDEO_FORMATS.replace(',', ', ')})"):
        container = av.open(f"file:{path.resolve()}", options=options)
        stream = container.streams.video[0]
    if stream.codec_context is None:
        raise InputError(path, "", "a stream of an unknown kind", "a video")
    width, height = max(stream.width, _square_pixel_width(stream, stream.sample_aspect_ratio)), stream.height
    if not _is_allowed_size(width, height):
        raise InputError(path, "size", f"{width} x {height} pixels", f"at most {MAX_CLIP_IMAGE_PIXELS / 1e6:g} million")
    stream.codec_context.options = {"max_pixels": str(MAX_CLIP_IMAGE_PIXELS)}  # later frames may have another size
    stream.thread_type = "AUTO"
    return container


@contextmanager
def _refuse_undecodable(path: Path, expected: str = "a video") -> Iterator[None]:
    from av.error import FFmpegError

    try:
        yield
    except (FFmpegError, IndexError, OSError, ValueError) as error:
        raise InputError(path, "", f"a file that does not decode as video ({error})", expected) from error


@dataclass(frozen=True)
class VideoTiming:
    """Presentation times of a video's frames, read without decoding, in units of ``base``.

    Attributes:
        times: times of all frames that have one, rising.
        keys: times of the key frames, rising, also of those not shown: of a video that was cut without encoding
            it anew, the first frames need the key frame before.
        untimed: number of frames without a time.
        base: seconds in a unit; None where the file does not say.
        start: time of the stream's begin; None where the file does not say.
        rate: average frames per second.
        aspect: width of a stored pixel over its height; None where the file does not say.
    """

    times: list[int]
    keys: list[int]
    untimed: int
    base: Fraction | None
    start: int | None
    rate: Fraction | None
    aspect: Fraction | None


def read_timing(path: Path, limit: int | None = None) -> VideoTiming:
    """Read the presentation times of a video's frames. Raises ``InputError``, also for more than ``limit`` frames."""
    times, keys, untimed = [], set(), 0
    with _refuse_undecodable(path), open_video(path) as container:
        stream = container.streams.video[0]
        for packet in container.demux(stream):
            if packet.size == 0:
                continue
            if packet.is_keyframe and packet.pts is not None:
                keys.add(packet.pts)
            if packet.is_discard:
                continue
            if packet.pts is None:
                untimed += 1
                continue
            times.append(packet.pts)
            if limit is not None and len(times) > limit:
                raise InputError(path, "", f"more than {limit} frames", "a shorter video")
        base, start, rate = stream.time_base, stream.start_time, stream.average_rate
        return VideoTiming(sorted(times), sorted(keys), untimed, base, start, rate, stream.sample_aspect_ratio)


def frame_times(path: Path) -> Float[ndarray, "N"] | None:
    """Read the times of all frames, from the first frame on [s]; None if incomplete. Raises ``InputError``."""
    timing = read_timing(path)
    times, base = timing.times, timing.base
    if not times or timing.untimed or len(set(times)) < len(times) or base is None:
        return None
    return np.array([float((tick - times[0]) * base) for tick in times])


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


def _decode_frames(path: Path) -> Iterator[tuple[UInt8[ndarray, "H W 3"], float]]:
    with open_video(path) as container, _refuse_undecodable(path):
        stream = container.streams.video[0]
        fps = float(stream.average_rate or 30)
        for frame in container.decode(stream):
            yield frame_to_rgb(frame, stream.sample_aspect_ratio), fps


def decode_at_times(
    path: Path, times: Sequence[Fraction], convert: Callable[[VideoFrame], Converted]
) -> Iterator[Converted]:
    """Decode the frames at rising times [s] from the stream's start: one seek, then onwards.

    Times after the end of the video yield no frame. Raises ``InputError``.
    """
    waiting = list(times)
    with _refuse_undecodable(path), open_video(path) as container:
        stream = container.streams.video[0]
        base = stream.time_base or Fraction(1, 90_000)
        begin = Fraction(stream.start_time or 0) * base
        half = 1 / (2 * Fraction(stream.average_rate or 60))
        container.seek(int((begin + waiting[0]) / base), stream=stream)  # to the key frame before
        for frame in container.decode(stream):
            if frame.pts is None:
                continue
            shown_at = frame.pts * base - begin
            image = None
            while waiting and shown_at + half >= waiting[0]:
                image = convert(frame) if image is None else image
                yield image
                waiting.pop(0)
            if not waiting:
                return


def _is_allowed_size(width: int, height: int) -> bool:
    return 0 < max(width, height) <= MAX_CLIP_SIDE_PX and width * height <= MAX_CLIP_IMAGE_PIXELS


def _square_pixel_width(frame: VideoFrame | VideoStream, aspect: Fraction | None) -> int:
    """Return the width of a stored frame with square pixels [px]."""
    return max(1, round(frame.width * aspect)) if aspect else frame.width


def frame_to_rgb(frame: VideoFrame, aspect: Fraction | None) -> UInt8[ndarray, "H W 3"]:
    """Return the RGB image of a frame as shown, pixels of an ``aspect`` made square. Raises ``ValueError`` by size."""
    width = _square_pixel_width(frame, aspect)
    if not _is_allowed_size(width, frame.height):
        raise ValueError(f"a frame of {width} x {frame.height} pixels")
    wide = frame if width == frame.width else frame.reformat(width=width, height=frame.height)
    return np.rot90(np.asarray(wide.to_ndarray(format="rgb24"), np.uint8), round(frame.rotation / 90.0))


def frame_to_bgr(frame: VideoFrame, aspect: Fraction | None, widest: int) -> UInt8[ndarray, "H W 3"]:
    """Return the BGR image of a frame as shown, scaled such that its stored width is at most ``widest`` [px]."""
    width = _square_pixel_width(frame, aspect)
    scale = min(1.0, widest / width)
    size = max(2, round(width * scale)), max(2, round(frame.height * scale))
    image = frame.to_ndarray(format="bgr24", width=size[0], height=size[1])
    return np.ascontiguousarray(np.rot90(image, frame.rotation // 90), np.uint8)


@dataclass
class ImageCache(Generic[Converted]):
    """The images that were requested last, at most ``limit`` bytes in all as ``weigh`` counts them."""

    weigh: Callable[[Converted], int]
    limit: int
    cached_bytes: int = 0
    images: OrderedDict[int, Converted] = field(default_factory=OrderedDict)

    def get(self, index: int) -> Converted | None:
        """Return a cached image; None where it is not cached."""
        if index in self.images:
            self.images.move_to_end(index)
        return self.images.get(index)

    def put(self, index: int, image: Converted) -> None:
        """Add an image, and drop the images not requested for the longest time."""
        if index in self.images:
            self.cached_bytes -= self.weigh(self.images.pop(index))
        self.cached_bytes += self.weigh(image)
        self.images[index] = image
        while self.cached_bytes > self.limit and len(self.images) > 1:
            _, old = self.images.popitem(last=False)
            self.cached_bytes -= self.weigh(old)


class FrameDecoder(Generic[Converted]):
    """Decoded frames of a video by index in the order of presentation, converted, the latest ones cached."""

    def __init__(
        self,
        path: Path,
        times: Sequence[int],
        keys: Sequence[int],
        convert: Callable[[VideoFrame], Converted],
        cache: ImageCache[Converted],
    ) -> None:
        """Prepare to decode a file whose frames, and key frames, have the presentation ``times`` and ``keys``."""
        self.path, self.cache = path, cache
        self._times, self._keys, self._convert = times, keys, convert
        self._lock = Lock()
        self._container: InputContainer | None = None
        self._decoded: Iterator[VideoFrame] = iter(())
        self._at = -1
        """Index of the frame decoded last."""

    def get(self, index: int) -> Converted:
        """Decode a frame, or return the cached one. Raises ``InputError``."""
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
        nearest = max(0, bisect_right(self._keys, self._times[index]) - 1)
        key = self._keys[nearest]
        if 0 <= self._at < index and self._times[self._at] >= key:
            self._advance(index, key)
            return
        # Containers seek by decoding times, some only roughly: after a later frame, start earlier, twice as far each
        # time, and finally at the beginning.
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
        """Decode up to a frame, caching it and some frames before it; return whether it was found.

        Frames before the key frame may be damaged and are skipped. Raises ``InputError`` for times that are not in the
        order of the frames: AVI does not keep the times of B-frames.
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
            if index - N_CACHED_PREVIOUS_FRAMES < at <= index and self.cache.get(at) is None:
                self.cache.put(at, self._convert(frame))
            if at >= index:
                return at == index
        self._decoded, self._at = iter(()), -1
        return False


@dataclass(frozen=True)
class FootageInterval:
    """Consecutive frames of a video or folder, from which a clip is cut.

    Attributes:
        first: number of the first frame, counted from 1.
        names: names of the frames in a clip.
        times: presentation times from the start of the footage [s].
        fps: frames per second.
        size: width and height as shown [px].
        rate: source of an assumed ``fps``.
        chosen: pattern of the images' names, for a folder of several sets of images.
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
        """Yield the RGB images. Raises ``InputError``, also for an image of another size."""
        last = self.first + len(self.names) - 1
        shown: Iterable[UInt8[ndarray, "H W 3"]] = (
            map(_read_frame_image, list_frame_images(self.path, self.chosen)[self.first - 1 : last])
            if self.path.is_dir()
            else video_frames(self.path, self.first, last)
        )
        for name, image in zip(self.names, shown, strict=True):
            if image.shape[1::-1] != self.size:
                got = f"{image.shape[1]} x {image.shape[0]} pixels in frame {printable(name)}"
                raise InputError(self.path, "size", got, "{} x {}, as the first frame has".format(*self.size))
            yield image


def size_and_rate(path: Path, fps: float | None, chosen: str = "") -> tuple[tuple[int, int], float]:
    """Return the size [px] and the frames per second of footage, ``fps`` if stated.

    Raises ``InputError``, and ``UsageError`` for options that the footage does not take.
    """
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
    """Return the frames of rising ``numbers``, counted from 1. Raises ``InputError`` for shorter footage."""
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
    """List the images of a folder, by the numbers in their names; ``chosen`` is a pattern of their names.

    Raises ``InputError`` without images, and for several sets of images, among which the command's ``option`` chooses.
    """
    paths = files.list_files(folder, IMAGE_SUFFIXES)
    if not paths:
        raise InputError(folder, "", "no images in it", f"a video, or a folder of images ({', '.join(IMAGE_SUFFIXES)})")
    chosen_paths = single_image_set(folder, paths, chosen, option)
    return sorted(chosen_paths, key=lambda path: (_natural_sort_key(path.stem), path.name))


def _natural_sort_key(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts frame9 before frame10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name) if part]


def _read_frame_image(path: Path) -> UInt8[ndarray, "H W 3"]:
    return decode_image(path, "", files.read_bytes(path, MAX_FRAME_FILE_BYTES), MAX_CLIP_SIDE_PX)
