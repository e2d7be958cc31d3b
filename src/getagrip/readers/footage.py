"""Frames by index, as JPEG: what the page shows. Of a video (``video``), or of a folder of images.

A video file as footage: every frame has its place in the order of presentation times.

The file is read through once without decoding, for the times of all its frames; ``Decoder`` then finds them by these
times, not by counting: so B-frames, start times other than zero and uneven rates do not matter.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, overload

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip.match_frames import single_image_set
from getagrip.errors import InputError
from getagrip.io.files import list_files, read_bytes
from getagrip.io.images import decode_image
from getagrip.readers.datasets.epic.epic_tables import EPIC_VIDEO_PATTERN, numbering_rate
from getagrip.readers.video import frame_to_rgb, open_video, square_pixel_width

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

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


N_CACHED_PREVIOUS_FRAMES = 48
"""Number of frames before a requested one that are kept, since they have been decoded: for steps back."""


class Decoder(Generic[CachedImage]):
    """Gives frames in some form, and keeps those that were asked for last."""

    def __init__(
        self,
        path: Path,
        times: Sequence[int],
        keys: Sequence[int],
        convert: Callable[[VideoFrame], CachedImage],
        weigh: Callable[[CachedImage], int],
        limit: int = JPEG_CACHE_BYTES,
    ) -> None:
        """Decode a file whose frames, and key frames, have these presentation times; ``limit`` bytes are kept."""
        self.path = path
        self._times, self._keys, self._convert = times, keys, convert
        self.cache = ImageCache(weigh, limit)
        self._lock = Lock()
        self._container: InputContainer | None = None
        self._decoded: Iterator[VideoFrame] = iter(())
        self._at = -1
        """Index of the frame decoded last."""

    def get(self, index: int) -> CachedImage:
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
            if index - N_CACHED_PREVIOUS_FRAMES < at <= index and self.cache.get(at) is None:
                self.cache.put(at, self._convert(frame))
            if at >= index:
                return at == index
        self._decoded, self._at = iter(()), -1
        return False


VIDEO_SUFFIXES = (".mp4", ".MP4", ".mov", ".MOV", ".m4v", ".mkv", ".webm", ".avi")
MAX_IMAGE_CACHE_BYTES = 256 * 2**20
"""Bytes of whole images that are kept."""


class VideoFootage:
    """A video file. Frames are numbered as EPIC-KITCHENS does where its name is one of theirs, else from 1."""

    def __init__(self, path: Path) -> None:
        """Read the times of all frames. Raises ``InputError`` for what is no video."""
        from av.error import FFmpegError

        self.path = path
        try:
            with open_video(path) as container:
                stream = container.streams.video[0]
                self._base = Fraction(stream.time_base or Fraction(1, 90_000))
                begin, rate = stream.start_time, float(stream.average_rate or 30)
                aspect = stream.sample_aspect_ratio
            self._times, keys = self._read_times(path)
        except (FFmpegError, IndexError, OSError, ValueError) as error:
            raise InputError(path, "", f"a file that is no video ({error})", "a video") from error
        self._begin = self._times[0] if begin is None else begin
        span = (self._times[-1] - self._times[0]) * self._base
        self.fps = float((self.frames - 1) / span) if span else rate
        self._rate = numbering_rate(path.stem) if EPIC_VIDEO_PATTERN.fullmatch(path.stem) else None
        self.shown = Decoder(path, self._times, keys, partial(_frame_to_jpeg, aspect=aspect), len)
        whole = partial(_upright_frame, aspect=aspect)
        self.whole = Decoder(path, self._times, keys, whole, lambda image: int(image.nbytes), MAX_IMAGE_CACHE_BYTES)

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
                if len(times) > MAX_FOOTAGE_FRAMES:
                    raise InputError(path, "", f"more than {MAX_FOOTAGE_FRAMES} frames", "a shorter video")
        if not times or not keys:
            raise InputError(path, "", "no frames", "a video")
        return sorted(times), sorted(keys)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self._times)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height, upright [px]. Raises ``InputError`` where the first frame does not decode."""
        height, width = self.image(0).shape[:2]
        return width, height

    def time(self, index: int) -> float:
        """Return the time at which a frame is shown, from the start of the stream [s]."""
        return float(self._time(index))

    def _time(self, index: int) -> Fraction:
        return (self._times[index] - self._begin) * self._base

    def number(self, index: int) -> int:
        """Return EPIC's number of a frame in one of its videos, else its place from 1."""
        return index + 1 if self._rate is None else round(self._time(index) * Fraction(self._rate)) + 1

    def index(self, number: int) -> int:
        """Return the frame of a number, as the reader of EPIC-Grasps finds it; the nearest where there is none."""
        if self._rate is None:
            found = number - 1
        else:
            half = Fraction(1, 2) / Fraction(self.fps).limit_denominator(100_000)
            wanted = (number - 1) / Fraction(self._rate) - half
            found = bisect_left(range(self.frames), wanted, key=self._time)
        return min(max(found, 0), self.frames - 1)

    def name(self, index: int) -> str:
        """Return a frame's place from 1, as ``clip new`` has it."""
        return f"{index + 1:06d}"

    def jpeg(self, index: int, whole: bool = False) -> bytes:
        """Return a frame for display, ``whole`` or made smaller where it is wide. Raises ``InputError``."""
        return (
            encode_footage_jpeg(self.image(index)[..., ::-1], MAX_FOOTAGE_SIDE_PX) if whole else self.shown.get(index)
        )

    def image(self, index: int) -> UInt8[ndarray, "H W 3"]:
        """Return a frame, all of its pixels: red, green, blue. Raises ``InputError`` where it does not decode."""
        return self.whole.get(index)

    def close(self) -> None:
        """Close the file, until a frame is asked for again."""
        self.shown.close()
        self.whole.close()


def _frame_to_jpeg(frame: VideoFrame, aspect: Fraction | None) -> bytes:
    """Encode a frame as JPEG, upright, made smaller where it is too wide."""
    width = square_pixel_width(frame, aspect)
    shrunk = min(1.0, MAX_DISPLAY_WIDTH_PX / width)
    size = max(2, round(width * shrunk)), max(2, round(frame.height * shrunk))
    image = frame.to_ndarray(format="bgr24", width=size[0], height=size[1])
    return encode_footage_jpeg(np.ascontiguousarray(np.rot90(image, frame.rotation // 90), np.uint8))


def _upright_frame(frame: VideoFrame, aspect: Fraction | None) -> UInt8[ndarray, "H W 3"]:
    """Return a frame, upright."""
    return np.ascontiguousarray(frame_to_rgb(frame, aspect))
