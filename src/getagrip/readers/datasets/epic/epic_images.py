"""EPIC-KITCHENS' images by frame number, at the masks' size, and EPIC-Fields' camera poses.

Images come from folders or archives of frames, or from the videos. EPIC-Fields' ``<video>.json`` has ``images``: by
frame name, the world-to-camera rotation, a quaternion (w, x, y, z), and translation, in an arbitrary scale. The authors
of EPIC-HIT publish a similarity into a metric world with gravity along -z for each of their videos, another
``<video>.json``: ``{"T": [[sR | t], ...]}``.
"""

from __future__ import annotations

import re
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import arrays
from getagrip.io.files import printable, read_bytes, read_json, shorten_value
from getagrip.io.images import decode_image
from getagrip.readers import streams
from getagrip.readers.datasets.epic.epic_tables import numbering_rate, subject_of
from getagrip.readers.datasets.epic.visor import DENSE_IMAGE_SIZE_PX
from getagrip.readers.video import decode_at_times

if TYPE_CHECKING:
    from av import VideoFrame

MAX_EPIC_IMAGE_BYTES = 16 * 2**20
"""Maximum size of an image file."""
MAX_EPIC_SIDE_PX = 4096
"""Maximum side of an image [px]; EPIC's images are 456 x 256, its videos 1920 x 1080."""
EPIC_VIDEO_SUFFIXES = (".MP4", ".mp4", ".mov", ".mkv")

Images = Callable[[Sequence[int]], list[UInt8[ndarray, "H W 3"]]]
"""A function that reads the RGB images of frames by EPIC's numbers. Raises ``InputError``."""
TAR_BLOCK_BYTES = tarfile.BLOCKSIZE
TAR_FRAME_PATTERN = re.compile(r"(?:.*/)?frame_(\d{10})\.jpg")


@dataclass(frozen=True)
class FrameArchive:
    """An uncompressed ``.tar`` of frames, read in place: the headers are read once."""

    path: Path

    @cached_property
    def places(self) -> dict[int, tuple[int, int]]:
        """Position of each frame's image in the archive, and its size in bytes. Raises ``InputError``."""
        try:
            return dict(self._members())
        except (OSError, tarfile.TarError) as error:
            got = f"a damaged file, or not an archive ({error})"
            raise InputError(self.path, "", got, "an uncompressed archive of frames (.tar)") from error

    def _members(self) -> Iterator[tuple[int, tuple[int, int]]]:
        length = self.path.stat().st_size
        with self.path.open("rb") as file:
            at = 0
            while at + TAR_BLOCK_BYTES <= length:
                file.seek(at)
                header = file.read(TAR_BLOCK_BYTES)
                if not header.strip(b"\0"):  # the end is marked by empty blocks
                    return
                member = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
                if not 0 <= member.size <= length:
                    raise InputError(self.path, "", f"a member of {member.size} bytes", f"{length} at most")
                named = TAR_FRAME_PATTERN.fullmatch(member.name)
                if named and member.isreg():
                    yield int(named[1]), (at + TAR_BLOCK_BYTES, member.size)
                at += TAR_BLOCK_BYTES + -(-member.size // TAR_BLOCK_BYTES) * TAR_BLOCK_BYTES

    def read(self, number: int, limit: int) -> bytes:
        """Read the file of a frame, of at most ``limit`` bytes. Raises ``InputError``."""
        key = f"frame_{number:010d}.jpg"
        if number not in self.places:
            raise InputError(self.path, key, "no such file in it", "the frame")
        begin, size = self.places[number]
        if size > limit:
            raise InputError(self.path, key, f"{size} bytes", f"at most {limit}")
        with self.path.open("rb") as file:
            file.seek(begin)
            content = file.read(size)
        if len(content) < size:
            raise InputError(self.path, key, "an archive that is cut short", "the whole archive")
        return content


@dataclass(frozen=True)
class Frames:
    """EPIC-KITCHENS' frames: ``[P01/[rgb_frames/]]P01_01/frame_0000000001.jpg``, or archives (``P01_01.tar``) there."""

    root: Path
    video: str

    def __call__(self, numbers: Sequence[int]) -> list[UInt8[ndarray, "H W 3"]]:
        """Read the images of some frames."""
        if not self.folder.is_dir() and self.archive is not None:
            path, archive = self.archive.path, self.archive
            read = partial(archive.read, limit=MAX_EPIC_IMAGE_BYTES)
            return [_decode_epic_image(path, f"frame_{n:010d}.jpg", read(n)) for n in numbers]
        paths = [self.folder / f"frame_{n:010d}.jpg" for n in numbers]
        return [_decode_epic_image(path, "", read_bytes(path, MAX_EPIC_IMAGE_BYTES)) for path in paths]

    @property
    def places(self) -> list[Path]:
        """Possible places of the video's folder."""
        subject = subject_of(self.video)
        return [folder / self.video for folder in (self.root / subject / "rgb_frames", self.root / subject, self.root)]

    @property
    def folder(self) -> Path:
        """Folder of the images, even if missing."""
        return next((place for place in self.places if place.is_dir()), self.places[-1])

    @cached_property
    def archive(self) -> FrameArchive | None:
        """The video's archive; None without one."""
        paths = [place.with_name(f"{place.name}.tar") for place in self.places]
        return next((FrameArchive(path) for path in paths if path.is_file()), None)


@dataclass(frozen=True)
class Video:
    """A folder of videos: EPIC's own layout (``P01/videos/P01_01.MP4``), or ``P01_01.MP4``."""

    root: Path
    video: str

    def __call__(self, numbers: Sequence[int]) -> list[UInt8[ndarray, "H W 3"]]:
        """Decode the images of some frames; frame n is the one shown at (n - 1) / rate seconds."""
        subject = subject_of(self.video)
        folders = (self.root / subject / "videos", self.root / subject, self.root)
        names = [f"{self.video}{suffix}" for suffix in EPIC_VIDEO_SUFFIXES]
        paths = [path for folder in folders for name in names if (path := folder / name).is_file()]
        if not paths:
            raise InputError(self.root, "", f"no {self.video}.MP4 in it", "the video")
        rate = Fraction(numbering_rate(self.video))
        times = {n: (n - 1) / rate for n in sorted(set(numbers))}
        found = dict(zip(times, decode_at_times(paths[0], list(times.values()), _resize_video_frame), strict=False))
        missing = [n for n in times if n not in found]
        if missing:
            raise InputError(paths[0], "", f"no frame {missing[0]} (at {float(times[missing[0]]):.2f} s)", "the frame")
        return [found[n] for n in numbers]


def _resize_video_frame(frame: VideoFrame) -> UInt8[ndarray, "H W 3"]:
    return _resize_to_masks(np.asarray(frame.to_ndarray(format="rgb24"), np.uint8))


def _decode_epic_image(path: Path, key: str, value: bytes) -> UInt8[ndarray, "H W 3"]:
    return _resize_to_masks(decode_image(path, key, value, MAX_EPIC_SIDE_PX))


def _resize_to_masks(image: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "H W 3"]:
    import cv2

    if image.shape[1::-1] == DENSE_IMAGE_SIZE_PX:
        return image
    shrinks = image.shape[1] > DENSE_IMAGE_SIZE_PX[0]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(image), DENSE_IMAGE_SIZE_PX, interpolation=how), np.uint8)


EPIC_WORLD_UP = np.array([0.0, 0.0, 1.0])
METRIC_SCALE_RANGE = 1e-4, 1e4
"""Plausible metres per unit of EPIC-Fields' worlds."""
MAX_ROTATION_DEVIATION = 1e-3
"""Maximum deviation of a similarity, divided by its scale, from a rotation."""
MAX_EPIC_POSITION_M = 1e3
"""Maximum distance of a camera from the origin [m]."""
EPIC_FIELDS_FRAME_PATTERN = re.compile(r"frame_(\d{1,10})\.jpg")


def read_metric_similarity(path: Path) -> tuple[float, Float[ndarray, "4 4"]]:
    """Read the scale s and motion (R, t) of a similarity, which takes EPIC-Fields' x to s R x + t [m].

    Raises ``InputError``.
    """
    content = read_json(path)
    value = content.get("T") if isinstance(content, dict) else content
    T = arrays.from_lists(value) if isinstance(value, list) else None
    if T is None or T.shape != (4, 4) or T.dtype.kind not in "fi" or not np.isfinite(T.astype(float)).all():
        raise InputError(path, "T", shorten_value(value), "a 4x4 matrix [sR | t], a similarity into metres")
    T = T.astype(float)
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    rigid = T.copy()
    rigid[:3, :3] /= scale if scale > 0.0 else 1.0
    off = np.abs(rigid[:3, :3] @ rigid[:3, :3].T - np.eye(3)).max()
    is_similarity = off <= MAX_ROTATION_DEVIATION and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
    if not METRIC_SCALE_RANGE[0] < scale < METRIC_SCALE_RANGE[1] or not is_similarity:
        raise InputError(path, "T", f"a scale of {scale:.3g}, {off:.2g} from a rotation", "a similarity [sR | t]")
    U, _, Vt = np.linalg.svd(rigid[:3, :3])
    return scale, se3.rigid(U @ Vt, rigid[:3, 3])


def read_epic_camera_poses(
    path: Path, scale: float, T_metric_world: Float[ndarray, "4 4"], wanted: range
) -> Mapping[int, Float[ndarray, "4 4"]]:
    """Read ``T_world_cam`` in the metric world by EPIC's frame numbers, for the ``wanted`` frames of EPIC-Fields.

    Raises ``InputError``.
    """
    found = {}
    for name, value in streams.stream_entries(path, "images"):
        number = EPIC_FIELDS_FRAME_PATTERN.fullmatch(name)
        if number is None:
            raise InputError(path, f"images.{printable(name)}", "this name", "a frame's, as frame_0000000001.jpg")
        if int(number[1]) not in wanted:
            continue
        q_t = arrays.from_lists(value) if isinstance(value, list) else None
        if q_t is None or q_t.shape != (7,) or q_t.dtype.kind not in "fi" or not _is_quaternion_pose(q_t.astype(float)):
            expected = "[qw, qx, qy, qz, tx, ty, tz], |q| = 1"
            raise InputError(path, f"images.{printable(name)}", shorten_value(value), expected)
        T_cam_world = se3.rigid(se3.from_quaternion(q_t[:4].astype(float)), q_t[4:].astype(float))
        T_world_cam = se3.inverse(T_cam_world)
        T_world_cam[:3, 3] *= scale
        T = T_metric_world @ T_world_cam
        if np.linalg.norm(T[:3, 3]) > MAX_EPIC_POSITION_M:
            raise InputError(path, f"images.{printable(name)}", f"a camera {np.linalg.norm(T[:3, 3]):.3g} m away",
                             f"at most {MAX_EPIC_POSITION_M:g} m")  # fmt: skip
        found[int(number[1])] = np.asarray(T)
    return found


def _is_quaternion_pose(q_t: Float[ndarray, "7"]) -> bool:
    return bool(np.isfinite(q_t).all() and abs(np.linalg.norm(q_t[:4]) - 1.0) < 1e-2)
