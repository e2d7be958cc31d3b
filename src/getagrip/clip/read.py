"""Read clips from their folders, every number checked (docs/formats.md); and segments from files of their own.

A file of segments, as ``segment --from-masks`` and ``annotate`` write it, has an entry for each clip or video:

    {"pour-01": {"segments": [{"state": "static", "first": "000743", "last": "000760"}, ...],
                 "source": "marked by ann", "still_camera": "as ann states"}, ...}

``segments`` is as in ``clip.json``, ``source`` their source, and ``still_camera`` the source of the statement that the
camera did not move. Other keys (``margins``, ``notes``) are for people.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict, cast

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.clip import Clip, World
from getagrip.clip.match_frames import number_of
from getagrip.clip.modality import modalities
from getagrip.clip.read_arrays import (
    EXPECTED_HAND_FILE,
    MAX_CAMERA_TRAVEL_M,
    MAX_FPS,
    MIN_FPS,
    OTHER_HAND_FILE,
    check_camera_poses,
    check_handle,
    check_in_view,
    check_intrinsics,
    check_times,
    frames_with_hand,
    read_hand,
    read_other_hand,
    read_truth,
)
from getagrip.clip.timeline import Segment, Side, at_frames, read_segments, segment_fields
from getagrip.errors import InputError, UsageError, check_arguments
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_mesh
from getagrip.io import arrays, files
from getagrip.provenance import Provenance, parse_provenance

CLIP_CAMERA_KEYS = ("K", "T_world_cam", "world_up", "world_support")
"""Keys of ``camera``; the second and third since version 2, the last since version 3."""


def parse_frame_names(path: Path, names: object) -> tuple[str, ...]:
    """Parse the frames' names: at least one, unique, each a plain file name. Raises ``InputError``."""
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(path, "frames", files.shorten_value(names), "a list of names, one for each frame")
    bad = next((name for name in names if not files.is_portable_name(name)), None)
    if bad is not None:
        got = f"the name {files.shorten_value(bad)}"
        raise InputError(path, "frames", got, "names of files, without folder and suffix")
    if len(set(names)) < len(names):
        twice = Counter(names).most_common(1)[0][0]
        raise InputError(path, "frames", f"the name {files.shorten_value(twice)} twice", "each frame once")
    return tuple(names)


def parse_intrinsics(
    path: Path, camera: dict[str, object], frames: int, size: tuple[int, int]
) -> Float[ndarray, "T 3 3"]:
    """Parse the pinhole intrinsics of each frame [px]. Raises ``InputError``."""
    K = parse_matrices(path, "camera.K", camera["K"], 3, frames)
    check_intrinsics(path, K, size)
    return K


def parse_world(path: Path, camera: dict[str, object], frames: tuple[str, ...]) -> World | None:
    """Parse the camera's trajectory in a static frame; None if unknown. Raises ``InputError``."""
    up = None if "world_up" not in camera else _numbers_to_array(camera["world_up"])
    if up is not None and not (up.shape == (3,) and abs(np.linalg.norm(up) - 1.0) < 1e-3):
        got = files.shorten_value(camera["world_up"])
        raise InputError(path, "camera.world_up", got, "[x, y, z], a direction of length 1")
    support = None if "world_support" not in camera else _numbers_to_array(camera["world_support"])
    if support is not None and not (support.shape == () and abs(support) <= MAX_CAMERA_TRAVEL_M):
        expected = f"a height [m], at most {MAX_CAMERA_TRAVEL_M:g} m from the world's origin"
        raise InputError(path, "camera.world_support", files.shorten_value(camera["world_support"]), expected)
    if support is not None and up is None:
        raise InputError(path, "camera.world_support", "it", "none without camera.world_up, along which it is")
    if "T_world_cam" not in camera:
        if up is not None:
            raise InputError(path, "camera.world_up", "it", "none without camera.T_world_cam, whose world it is in")
        return None
    T = parse_matrices(path, "camera.T_world_cam", camera["T_world_cam"], 4, len(frames))
    check_camera_poses(path, T, frames)
    return World(T, up, None if support is None else float(support))


def parse_handle(path: Path, value: object, mesh: Mesh) -> Float[ndarray, "P 3"]:
    """Parse points along the handle's middle line, in the frame of the mesh [m]. Raises ``InputError``."""
    points = np.zeros((0, 3)) if value == [] else _numbers_to_array(value)
    if points.ndim != 2 or points.shape[1] != 3:
        expected = "a list of points [x, y, z] [m]; an empty one for a mesh without a handle"
        raise InputError(path, "handle", files.shorten_value(value), expected)
    check_handle(path, points, mesh)
    return points


def parse_times(path: Path, value: object, frames: tuple[str, ...]) -> Float[ndarray, "T"]:
    """Parse the time of each frame [s]. Raises ``InputError``."""
    values = _numbers_to_array(value)
    if values.ndim != 1:
        raise InputError(path, "times", files.shorten_value(value), "a list of numbers [s], one for each frame")
    if len(values) != len(frames):
        raise InputError(path, "times", f"{len(values)} numbers", f"one for each of the {len(frames)} frames")
    check_times(path, values, frames)
    return values


def parse_matrices(path: Path, key: str, value: object, rows: int, frames: int) -> Float[ndarray, "T rows rows"]:
    """Parse a square matrix of finite numbers for each frame, or one for all frames."""
    values = _numbers_to_array(value)
    if values.shape[-2:] != (rows, rows) or values.ndim not in (2, 3):
        expected = f"a {rows}x{rows} matrix of numbers, or one for each frame"
        raise InputError(path, key, files.shorten_value(value), expected)
    if values.ndim == 3 and len(values) != frames:
        raise InputError(path, key, f"{len(values)} matrices", f"one, or one for each of the {frames} frames")
    return np.broadcast_to(values, (frames, rows, rows)).copy()


def _numbers_to_array(value: object) -> Float[ndarray, "..."]:
    """Convert lists of numbers, finite by JSON's reader, to an array; a scalar NaN for other values."""
    values = arrays.from_lists(value)
    return np.array(np.nan) if values is None or values.dtype.kind not in "fi" else values.astype(float)


CLIP_FORMAT_VERSION = 4
"""Version of written clips; older ones can be read."""
REQUIRED_CLIP_KEYS = ("version", "name", "category", "side", "fps", "frames", "size", "camera", "mesh", "scale")
OPTIONAL_KEYS_BY_VERSION = {1: ("provenance",), 2: ("provenance", "times"), 3: ("provenance", "times", "segments")}
OPTIONAL_KEYS_BY_VERSION[4] = (*OPTIONAL_KEYS_BY_VERSION[3], "depth", "handle")
"""Further keys of ``clip.json`` by its version."""
CAMERA_KEYS_BY_VERSION = {1: CLIP_CAMERA_KEYS[:1], 2: CLIP_CAMERA_KEYS[:3], 3: CLIP_CAMERA_KEYS, 4: CLIP_CAMERA_KEYS}
"""Keys of ``camera`` by version; only the first is required."""
MAX_CLIP_SIDE_PX, MAX_CLIP_IMAGE_PIXELS = 16384, 40_000_000
"""Maximum side [px] and number of pixels of an image, above those of 8K video."""


class ClipFields(TypedDict, total=False):
    """The keys of ``clip.json``."""

    version: int
    name: str
    category: str
    side: Side
    fps: float
    frames: object
    size: object
    camera: dict[str, object]
    mesh: str
    scale: Literal["known", "free"]
    provenance: Provenance
    times: object
    segments: object
    depth: object
    handle: object


@check_arguments
def read_clip(folder: str | Path) -> Clip:
    """Read and check a clip, except its masks and images, in the frames with a hand.

    Args:
        folder: the clip's folder, or the ``clip.json`` in it (docs/formats.md).

    Raises:
        InputError: a file is missing, damaged or impossible. The message names the file and the key.
    """
    folder = _resolve_clip_folder(folder)
    path = folder / "clip.json"
    fields = _read_clip_fields(folder)
    frames = parse_frame_names(path, fields["frames"])
    size = parse_image_size(path, fields["size"])
    mesh = read_mesh(_mesh_path(folder, fields))
    hand_path = files.inside(folder, "hand.npz", "", EXPECTED_HAND_FILE)
    rows = frames_with_hand(hand_path, frames)
    hand = read_hand(hand_path, len(rows))
    K = parse_intrinsics(path, fields["camera"], len(frames), size)[rows]
    when = parse_times(path, fields["times"], frames)[rows] if "times" in fields else None
    if when is None and len(rows) < len(frames):
        when = rows / float(fields["fps"])
    where = parse_world(path, fields["camera"], frames)
    segments = read_segments(path, fields.get("segments", []), frames, where is not None)
    check_in_view(folder / "hand.npz", hand, K, size)
    other = read_other_hand(folder, frames, rows, K, size)
    has_truth = (folder / "truth.npz").exists() or (folder / "truth.npz").is_symlink()
    return Clip(
        folder=folder,
        name=fields["name"],
        category=fields["category"],
        handle=parse_handle(path, fields["handle"], mesh) if "handle" in fields else None,
        side=fields["side"],
        fps=float(fields["fps"]),
        frames=tuple(frames[row] for row in rows),
        size=size,
        K=K,
        mesh=mesh,
        scale=fields["scale"],
        hand=hand,
        truth=read_truth(folder, hand, fields["scale"], mesh) if has_truth else None,
        times=when,
        world=None if where is None else where.take(rows),
        segments=at_frames(segments, rows),
        other_hand=other,
        provenance=fields["provenance"],
    )


@dataclass(frozen=True)
class ClipHeader:
    """The checked content of ``clip.json``, including frames without a hand; hands, mesh and masks are not read."""

    folder: Path
    fields: ClipFields
    frames: tuple[str, ...]
    size: tuple[int, int]
    K: Float[ndarray, "T 3 3"]

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / "clip.json"

    @property
    def times(self) -> Float[ndarray, "T"]:
        """(T,) times of the frames [s]: as stated, or by the frames' numbers at the clip's rate."""
        if "times" in self.fields:
            return np.array(self.fields["times"], dtype=float)
        numbers = [number_of(name) for name in self.frames]
        at = np.arange(len(numbers)) if None in numbers else np.array(numbers) - int(numbers[0] or 0)
        return np.asarray(at / float(self.fields["fps"]))

    def changed(self, new: Mapping[str, object]) -> dict[str, object]:
        """Return the content of ``clip.json`` with ``new`` fields, in the current version."""
        return {**self.fields, **new, "version": CLIP_FORMAT_VERSION}


def read_header(folder: str | Path) -> ClipHeader:
    """Read the header of a clip, which may still lack its hands. Raises ``InputError``."""
    folder = _resolve_clip_folder(folder)
    fields, path = _read_clip_fields(folder), folder / "clip.json"
    frames, size = parse_frame_names(path, fields["frames"]), parse_image_size(path, fields["size"])
    if "times" in fields:
        parse_times(path, fields["times"], frames)
    where = parse_world(path, fields["camera"], frames)
    read_segments(path, fields.get("segments", []), frames, where is not None)
    return ClipHeader(folder, fields, frames, size, parse_intrinsics(path, fields["camera"], len(frames), size))


def read_name(folder: str | Path) -> str:
    """Read the name of a clip, checking only its ``clip.json``. Raises ``InputError``."""
    return _read_clip_fields(_resolve_clip_folder(folder))["name"]


def input_sha256(folder: str | Path) -> str:
    """Compute the checksum of a reconstruction's inputs: ``clip.json``, hands, mesh, evidence; not truth.

    Images are evidence beside a mesh with colours, or one that may be a body of revolution, only
    (``fitting.evidence.texture``). Raises ``InputError`` for a missing file.
    """
    folder = _resolve_clip_folder(folder)
    fields = _read_clip_fields(folder)
    hand = files.inside(folder, "hand.npz", "", EXPECTED_HAND_FILE)
    frames = parse_frame_names(folder / "clip.json", fields["frames"])
    paths = {"clip.json": folder / "clip.json", "hand.npz": hand, fields["mesh"]: _mesh_path(folder, fields)}
    if (folder / OTHER_HAND_FILE).exists():
        paths[OTHER_HAND_FILE] = files.inside(folder, OTHER_HAND_FILE, "", EXPECTED_HAND_FILE)
    with_hand = [frames[row] for row in frames_with_hand(hand, frames)]
    for name in (name for modality in modalities() for name in modality.files(folder, with_hand)):
        paths[name] = files.inside(folder, name, "", "evidence for each frame of clip.json")
    return files.sha256(paths)


def _resolve_clip_folder(path: str | Path) -> Path:
    path = Path(path)
    return path.parent if path.name == "clip.json" else path


def _mesh_path(folder: Path, fields: ClipFields) -> Path:
    return files.inside(folder, fields["mesh"], "mesh", "a triangle mesh", source=folder / "clip.json")


def _read_clip_fields(folder: Path) -> ClipFields:
    """Read the fields of ``clip.json``: keys are complete and known, single texts and numbers are checked."""
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "the folder of a clip")
    path = files.inside(folder, "clip.json", "", "the description of a clip")
    fields = files.read_json(path)
    version = fields.get("version", CLIP_FORMAT_VERSION)
    if type(version) is not int or version not in OPTIONAL_KEYS_BY_VERSION:
        raise InputError(path, "version", files.shorten_value(version), " or ".join(map(str, OPTIONAL_KEYS_BY_VERSION)))
    _check_known_keys(path, "", fields, (*REQUIRED_CLIP_KEYS, *OPTIONAL_KEYS_BY_VERSION[version]), version)
    missing = next((key for key in REQUIRED_CLIP_KEYS if key not in fields), None)
    if missing is not None:
        raise InputError(path, missing, "no such key", "the key")

    def require(key: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(path, key, files.shorten_value(fields[key]), expected)

    name, mesh, category, camera = fields["name"], fields["mesh"], fields["category"], fields["camera"]
    can_name = isinstance(name, str) and files.is_portable_name(name)
    require("name", can_name, "a text that can name a folder: printable, no slash, at most 200 bytes")
    require("category", isinstance(category, str) and category != "" and category.isprintable(), "a printable text")
    require("side", fields["side"] in ("left", "right"), '"left" or "right"')
    plausible = _is_float_number(fields["fps"]) and MIN_FPS <= fields["fps"] <= MAX_FPS
    require("fps", plausible, f"frames per second, {MIN_FPS:g} to {MAX_FPS:g}")
    require("mesh", isinstance(mesh, str) and mesh != "", "the name of a mesh file")
    require("scale", fields["scale"] in ("known", "free"), '"known" or "free"')
    require("provenance", isinstance(fields.setdefault("provenance", {}), dict), "an object")
    require("camera", isinstance(camera, dict) and "K" in camera, '{"K": 3x3} or {"K": [3x3, ...]}')
    _check_known_keys(path, "camera.", camera, CAMERA_KEYS_BY_VERSION[version], version)
    return cast(ClipFields, fields | {"provenance": parse_provenance(path, fields["provenance"], version)})


def _check_known_keys(path: Path, where: str, stored: dict[str, object], known: tuple[str, ...], version: int) -> None:
    """Raise ``InputError`` for a key unknown to a version."""
    unknown = next((key for key in stored if key not in known), None)
    if unknown is not None:
        expected = f"one of {', '.join(known)} (version {version})"
        raise InputError(path, f"{where}{files.printable(unknown)}", "an unknown key", expected)


def _is_float_number(value: object) -> bool:
    """Return whether a JSON value is a number in the range of floats."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and math.isfinite(value)


def parse_image_size(path: Path, size: object) -> tuple[int, int]:
    """Parse width and height [px]."""
    sides = size if isinstance(size, list) else []
    if len(sides) != 2 or not all(type(side) is int and 0 < side <= MAX_CLIP_SIDE_PX for side in sides):
        expected = f"[width, height] in whole pixels, 1 to {MAX_CLIP_SIDE_PX} each"
        raise InputError(path, "size", files.shorten_value(size), expected)
    if sides[0] * sides[1] > MAX_CLIP_IMAGE_PIXELS:
        expected = f"at most {MAX_CLIP_IMAGE_PIXELS / 1e6:g} million pixels"
        raise InputError(path, "size", files.shorten_value(size), expected)
    return sides[0], sides[1]


SEGMENTS_SOURCE_KEY, CAMERA_POSE_KEY = "segments", "camera_pose"
"""Keys of a clip's provenance."""
STATED_BY_USER = "as the user states"
"""``SegmentList.still_camera`` for the command line's option."""
MAX_TEXT_CHARACTERS = 500


@dataclass(frozen=True)
class SegmentList:
    """The segments of one clip or video.

    Attributes:
        path: the file, or its place in errors.
        key: key of the clip or video in the file.
        rows: unchecked content of ``segments`` in ``clip.json``.
        source: source of the segments; None if not stated.
        still_camera: source of the statement that the camera did not move; None without a statement.
    """

    path: Path
    key: str
    rows: Sequence[Mapping[str, object]]
    source: str | None
    still_camera: str | None = None

    @staticmethod
    def of(clip: Clip, segments: Sequence[Segment], source: str, still_camera: str | None = None) -> SegmentList:
        """Make a list of a clip's segments that are in memory."""
        return SegmentList(clip.origin, "segments", segment_fields(segments, clip.frames), source, still_camera)

    @property
    def fields(self) -> dict[str, object]:
        """The entry in a file of segments."""
        about = {"source": self.source, "still_camera": self.still_camera}
        return {"segments": self.rows, **{key: text for key, text in about.items() if text is not None}}

    def at(self, frames: Sequence[str], has_world: bool) -> tuple[Segment, ...]:
        """Return the segments in a clip with these frames, cropped to it. Raises ``InputError`` if none is in it.

        Frame names that are numbers are compared as numbers: ``"86"`` and ``"000086"`` are equal.
        """
        inside = [row for row in (_crop_segment(row, frames) for row in self.rows) if row is not None]
        if self.rows and not inside:
            first, last = map(files.shorten_value, (self.rows[0].get("first"), self.rows[-1].get("last")))
            listed = f"segments from {first} to {last}"
            raise InputError(self.path, self.key, listed, f"some of the frames {frames[0]} to {frames[-1]}")
        try:
            return read_segments(self.path, inside, frames, has_world)
        except InputError as error:
            hint = "; --still-camera says that the camera did not move" if error.key.endswith(".state") else ""
            raise InputError(self.path, f"{self.key}.{error.key}", error.got, f"{error.expected}{hint}") from error


def read_segment_list(path: Path, names: Sequence[str]) -> SegmentList:
    """Read the entry of the first of ``names`` in a file of segments, or its only entry. Raises ``InputError``."""
    content = files.read_json(path)
    key = next((name for name in names if name in content), None)
    if key is None and len(content) == 1:
        (key,) = content
    if key is None:
        there = ", ".join(map(files.printable, list(content)[:5])) or "nothing"
        raise InputError(path, "", f"the segments of {there}", f"those of {' or '.join(names)}")
    entry = content[key]
    rows = entry.get("segments") if isinstance(entry, dict) else None
    shown = files.printable(key)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(path, shown, files.shorten_value(entry), 'an object with "segments", a list of objects')
    source, still = (
        _parse_segment_text(path, f"{shown}.{name}", entry.get(name)) for name in ("source", "still_camera")
    )
    return SegmentList(path, shown, rows, source or f"from {path.name}", still)


def add_segments(clip: Clip, listed: SegmentList) -> Clip:
    """Add segments to a clip and, if it has no camera poses, those of a camera stated to be still.

    Raises ``InputError`` for segments that are malformed or outside the clip.
    """
    still = listed.still_camera if clip.world is None else None
    world = clip.world if still is None else World(np.tile(np.eye(4), (len(clip), 1, 1)))
    segments = listed.at(clip.frames, world is not None)
    known = clip.provenance | _segment_provenance(listed.source, still)
    return replace(clip, segments=segments, world=world, provenance=known)


def check_segments_replaceable(header: ClipHeader, overwrite: bool) -> None:
    """Raise ``UsageError`` if a clip has segments, unless ``overwrite``."""
    if header.fields.get("segments") and not overwrite:
        raise UsageError(f"{header.folder / 'clip.json'}: has segments already; --overwrite replaces them")


def write_clip_segments(header: ClipHeader, listed: SegmentList) -> tuple[Segment, ...]:
    """Write segments into the ``clip.json`` of a folder, replacing older ones.

    Camera poses stay unchanged, unless they came from a statement that the camera is still. Raises ``InputError`` for
    segments that are malformed or outside the clip.
    """
    fields, camera = header.fields, header.fields["camera"]
    has_world = "T_world_cam" in camera and CAMERA_POSE_KEY not in fields["provenance"]
    still = None if has_world else listed.still_camera
    segments = listed.at(header.frames, still is not None or "T_world_cam" in camera)
    pose = {} if still is None else {"T_world_cam": np.eye(4)}
    new = {"camera": {**camera, **pose}, "segments": segment_fields(segments, header.frames)}
    known = fields["provenance"] | _segment_provenance(listed.source, still)
    with files.new_file(header.folder / "clip.json") as part:
        files.write_json(part, header.changed({**new, "provenance": known}))
    return segments


def _segment_provenance(source: str | None, still_camera: str | None) -> dict[str, str]:
    """Return the sources of segments, and of a still camera's poses."""
    still = None if still_camera is None else f"identity: the camera stands still, {still_camera}"
    return {key: text for key, text in ((SEGMENTS_SOURCE_KEY, source), (CAMERA_POSE_KEY, still)) if text is not None}


def _parse_segment_text(path: Path, key: str, value: object) -> str | None:
    if value is None:
        return None
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT_CHARACTERS or not value.isprintable():
        raise InputError(path, key, files.shorten_value(value), f"a text of up to {MAX_TEXT_CHARACTERS} letters")
    return value


def _crop_segment(row: Mapping[str, object], frames: Sequence[str]) -> Mapping[str, object] | None:
    """Crop a segment to a clip's frames; None if it is outside. Segments of frames without numbers stay unchanged."""
    ends = [row.get("first"), row.get("last")]
    if not all(_is_frame_number(name) for name in (*ends, *frames)):
        return row
    first, last = (int(str(end)) for end in ends)
    within = [name for name in frames if first <= int(name) <= last]
    if first > last or not within:
        return row if first > last else None
    return {**row, "first": within[0], "last": within[-1]}


def _is_frame_number(name: object) -> bool:
    return isinstance(name, str) and name.isascii() and name.isdigit() and len(name) < 16
