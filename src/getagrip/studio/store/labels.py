"""Labels of a grasp's frames: joints of the hand, polygons and strokes; as files, and as key frames in the database.

A label file is JSON, one file for one grasp:

    {"video": "kitchen.mp4", "sha256": "9f86d0...", "size": [1920, 1080], "side": "left", "fps": 30.0,
     "first": 57, "last": 112,
     "frames": {"57": {"joints": [[x, y], null, ...], "object": [[[x, y], ...], ...], "front": [[[x, y], ...], ...]}}}

Frames are counted from 0, first and last included; points are in pixels of the footage, the middle of its first pixel
at (0.5, 0.5). ``joints`` are 21, wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip, null
where not clicked. ``object`` are polygons around the visible parts of the object, ``front`` around its occluders except
the hand, ``hand`` around the visible hand; where they overlap, the last kind counts. ``on`` and ``off`` are strokes,
lines or single points on the object or beside it (``stroke_prompt``). All keys of a frame are optional. A missing key
means no label, an empty list of polygons that no part is visible. ``sha256``, the footage's checksum, is optional.

A key frame holds one annotator's labels of one frame of a grasp. A change of it names the joints and polygons
(``outlines``) that it sets; null removes one:

    {"joints": {"4": [x, y], "5": "unseen", "6": null},
     "outlines": {"<its name>": {"of": "object", "closed": true, "points": [[x, y], ...]}},
     "hidden": false, "deleted": false}

The kind of an outline ("of") is a key of a label file's frame; strokes are always closed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip.read import MAX_CLIP_IMAGE_PIXELS, MAX_CLIP_SIDE_PX
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io import files
from getagrip.io.files import Json, shorten_value
from getagrip.readers.footage import MAX_FOOTAGE_SIDE_PX
from getagrip.readers.masks.mask_regions import fill_polygons
from getagrip.studio.store.history import TOKEN_PATTERN, RefusedError, Row, VersionDatabase, Versions

OBJECT_LABEL, OCCLUDER_LABEL, HAND_LABEL = 1, 2, 3
"""Values of a label map; other pixels are 0."""
MAX_FRAME_INDEX = 10**7
MIN_SHAPE_POINTS = {"object": 3, "front": 3, "hand": 3, "on": 1, "off": 1}
"""Kinds of polygons, then of strokes, and the minimum number of points of each."""
MAX_POLYGONS_PER_KIND, MAX_LABEL_POLYGON_CORNERS = 100, 5000
"""Maximum number of polygons of one frame and kind, and of corners of one polygon."""

Polygons = tuple[Float[ndarray, "_ 2"], ...]


@dataclass(frozen=True)
class FrameLabels:
    """The labels of one frame."""

    joints: Float[ndarray, "21 2"] | None = None
    """NaN where not clicked [px]."""
    object: Polygons | None = None
    front: Polygons | None = None
    """Polygons around occluders."""
    hand: Polygons | None = None
    on: Polygons | None = None
    """Strokes on the object."""
    off: Polygons | None = None
    """Strokes beside the object."""


@dataclass(frozen=True)
class Labels:
    """The labels of the frames of one grasp."""

    video: str
    """Name of the footage."""
    size: tuple[int, int]
    """Width and height of its images [px]."""
    side: Side
    fps: float
    first: int
    last: int
    frames: dict[int, FrameLabels]
    sha256: str = ""
    """Checksum of the footage; empty where it is not known."""

    @property
    def clicks(self) -> dict[int, Float[ndarray, "21 2"]]:
        """Joints by frame, in order of frames, where any are clicked."""
        return {n: frame.joints for n, frame in sorted(self.frames.items()) if frame.joints is not None}

    @property
    def drawn(self) -> list[int]:
        """Frames on which the object has polygons or strokes, or is marked as not visible, in order."""
        return [n for n, frame in sorted(self.frames.items()) if frame.object is not None or frame.on]

    def label_maps(self) -> dict[int, UInt8[ndarray, "H W"]]:
        """Make label maps from polygons, of the frames ``drawn``.

        Values are 0, ``OBJECT_LABEL``, ``OCCLUDER_LABEL`` or ``HAND_LABEL``. ``stroke_prompt.keyframe_label_maps`` uses
        strokes, too.
        """
        return {n: _render_label_map(self.frames[n], self.size) for n in self.drawn}


def _render_label_map(frame: FrameLabels, size: tuple[int, int]) -> UInt8[ndarray, "H W"]:
    out = np.zeros(size[::-1], np.uint8)
    for value, shapes in ((OBJECT_LABEL, frame.object), (OCCLUDER_LABEL, frame.front), (HAND_LABEL, frame.hand)):
        corners = [shape.ravel().tolist() for shape in shapes or ()]
        out[fill_polygons(Path(), "", corners, size)] = value
    return out


def read_label_file(path: str | Path) -> Labels:
    """Read the labels in a file. Raises ``InputError``."""
    return parse_labels(files.read_json(Path(path)), path)


def write_label_file(labels: Labels, path: str | Path) -> None:
    """Write labels to a file, one line per frame, whole or not at all."""
    fields = labels_to_json(labels)
    frames = ",\n".join(f"  {json.dumps(n)}: {json.dumps(frame)}" for n, frame in fields.pop("frames").items())
    files.write_bytes(Path(path), f'{json.dumps(fields)[:-1]}, "frames": {{\n{frames}\n}}}}\n'.encode())


def labels_to_json(labels: Labels) -> files.Json:
    """Convert labels to the JSON of a label file."""
    fields = {key: getattr(labels, key) for key in ("video", "side", "fps", "first", "last")}
    frames = {str(n): _frame_to_json(frame) for n, frame in sorted(labels.frames.items())}
    checksum = {"sha256": labels.sha256} if labels.sha256 else {}
    return fields | checksum | {"size": list(labels.size), "frames": frames}


def _frame_to_json(frame: FrameLabels) -> dict[str, object]:
    out: dict[str, object] = {}
    if frame.joints is not None:
        out["joints"] = [None if np.isnan(point).any() else _round_point(point) for point in frame.joints]
    for key in MIN_SHAPE_POINTS:
        shapes = getattr(frame, key)
        if shapes is not None:
            out[key] = [[_round_point(point) for point in shape] for shape in shapes]
    return out


def _round_point(point: Float[ndarray, "2"]) -> list[float]:
    """Round to a hundredth of a pixel, finer than a click."""
    return [round(float(x), 2) for x in point]


def parse_labels(content: files.Json, source: str | Path) -> Labels:
    """Parse and check the JSON of a label file. Raises ``InputError`` about the file ``source``."""
    path = Path(source)
    needed = {"video", "size", "side", "fps", "first", "last", "frames"}
    _check_label_keys(path, "", content, {*needed, "sha256"}, needed)

    def check(key: str, fine: bool, expected: str) -> None:
        if not fine:
            raise InputError(path, key, shorten_value(content[key]), expected)

    size, first, last, rate = (content[key] for key in ("size", "first", "last", "fps"))
    most = f"at most {MAX_CLIP_IMAGE_PIXELS / 1e6:g} million in all"
    check("size", _is_image_size(size), f"width and height in pixels, {most}")
    for key, value, least in (("first", first, 0), ("last", last, first)):
        fine = type(value) is int and least <= value <= MAX_FRAME_INDEX
        check(key, fine, f"a whole number from {least} to {MAX_FRAME_INDEX}")
    check("video", _is_file_name(content["video"]), "the name of a file, without folders")
    check("side", content["side"] in get_args(Side), "left or right")
    check("fps", _is_finite_number(rate) and 0.1 <= rate <= 10_000, "frames per second, 0.1 to 10000")
    check("frames", isinstance(content["frames"], Mapping), "an object with a key for each frame")
    frames = _parse_frames(path, content["frames"], (first, last), (size[0], size[1]))
    checksum = content.get("sha256", "")
    fine = isinstance(checksum, str) and re.fullmatch(r"([0-9a-f]{64})?", checksum) is not None
    check("sha256", fine, "64 hexadecimal digits, as sha256sum prints them")
    return Labels(
        content["video"], (size[0], size[1]), content["side"], float(rate), first, last, frames, sha256=checksum
    )


def _is_file_name(value: object) -> bool:
    return isinstance(value, str) and files.is_portable_name(value)


def _is_image_size(value: object) -> bool:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(type(n) is int and n > 0 for n in value):
        return False
    return max(value) <= MAX_CLIP_SIDE_PX and int(value[0] * value[1]) <= MAX_CLIP_IMAGE_PIXELS


def _parse_frames(
    path: Path, content: Mapping[str, object], extent: tuple[int, int], size: tuple[int, int]
) -> dict[int, FrameLabels]:
    out = {}
    for text, frame in content.items():
        where = f"frames.{files.printable(text)}"
        if not re.fullmatch(r"0|[1-9][0-9]{0,7}", text) or not extent[0] <= int(text) <= extent[1]:
            raise InputError(path, where, "a key that is no frame of the grasp", f"{extent[0]} to {extent[1]}")
        if not isinstance(frame, Mapping):
            raise InputError(path, where, shorten_value(frame), "an object")
        _check_label_keys(path, where, frame, {"joints", *MIN_SHAPE_POINTS}, set())
        joints = _parse_joints(path, f"{where}.joints", frame.get("joints"), size)
        shapes = {
            kind: _parse_polygons(path, f"{where}.{kind}", frame.get(kind), size, least)
            for kind, least in MIN_SHAPE_POINTS.items()
        }
        out[int(text)] = FrameLabels(joints, **shapes)
    return dict(sorted(out.items()))


def _check_label_keys(path: Path, where: str, value: Mapping[str, object], known: set[str], needed: set[str]) -> None:
    """Raise ``InputError`` for unknown and missing keys."""
    for key in [key for key in value if key not in known][:1]:
        expected = f"one of {', '.join(sorted(known))}"
        raise InputError(path, f"{where}.{files.printable(key)}".lstrip("."), "an unknown key", expected)
    for key in sorted(needed - value.keys())[:1]:
        raise InputError(path, key, "no such key", "it")


def _parse_joints(path: Path, key: str, value: object, size: tuple[int, int]) -> Float[ndarray, "21 2"] | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 21:
        raise InputError(path, key, shorten_value(value), "21 points, null where there is none")
    rows = [
        [math.nan, math.nan] if point is None else _parse_point(path, f"{key}[{n}]", point, size)
        for n, point in enumerate(value)
    ]
    return np.array(rows)


def _parse_polygons(path: Path, key: str, value: object, size: tuple[int, int], least: int) -> Polygons | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) > MAX_POLYGONS_PER_KIND:
        raise InputError(path, key, shorten_value(value), f"at most {MAX_POLYGONS_PER_KIND} shapes [[x, y], ...]")
    out = []
    for n, corners in enumerate(value):
        if not isinstance(corners, list | tuple) or not least <= len(corners) <= MAX_LABEL_POLYGON_CORNERS:
            expected = f"{least} to {MAX_LABEL_POLYGON_CORNERS} corners [x, y]"
            raise InputError(path, f"{key}[{n}]", shorten_value(corners), expected)
        out.append(np.array([_parse_point(path, f"{key}[{n}][{k}]", corner, size) for k, corner in enumerate(corners)]))
    return tuple(out)


def _parse_point(path: Path, key: str, value: object, size: tuple[int, int]) -> list[float]:
    """Parse a point in the image, or outside it by no more than the image's size."""
    pair = isinstance(value, list | tuple) and len(value) == 2 and all(_is_finite_number(x) for x in value)
    if not pair or not isinstance(value, list | tuple):
        raise InputError(path, key, shorten_value(value), "[x, y] in pixels")
    if not all(-side <= x <= 2 * side for x, side in zip(value, size, strict=True)):
        raise InputError(path, key, shorten_value(value), f"a point in or about the {size[0]} x {size[1]} image")
    return [float(x) for x in value]


def _is_finite_number(value: object) -> bool:
    """Return whether a value is a finite number, no bool."""
    return type(value) is int or (isinstance(value, float) and math.isfinite(value))


KEYFRAME_SETTABLE_FIELDS = frozenset({"joints", "outlines", "hidden", "deleted"})
"""Fields that a change may set."""
UNSEEN_JOINT = "unseen"
"""Value of a joint that the annotator has skipped because it is not visible."""
N_KEYFRAME_JOINTS = 21
MAX_KEYFRAME_SIZE_PX = (MAX_FOOTAGE_SIDE_PX, MAX_FOOTAGE_SIDE_PX)
"""Limit of image sizes, for points of images of unknown size."""
KEYFRAMES_SCHEMA = """
CREATE TABLE keyframe_versions (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    change TEXT NOT NULL UNIQUE, tab TEXT NOT NULL, at TEXT NOT NULL,
    undoes INTEGER REFERENCES keyframe_versions (seq),
    keyframe TEXT NOT NULL, task TEXT NOT NULL, annotator TEXT NOT NULL,
    grasp TEXT NOT NULL, frame INTEGER NOT NULL,
    joints TEXT NOT NULL, outlines TEXT NOT NULL, hidden INTEGER NOT NULL, deleted INTEGER NOT NULL
);
CREATE INDEX versions_of_keyframe ON keyframe_versions (keyframe, seq);
CREATE INDEX versions_of_grasp ON keyframe_versions (grasp, annotator, tab);
CREATE VIEW keyframes AS SELECT * FROM keyframe_versions AS v
    WHERE seq = (SELECT max(seq) FROM keyframe_versions WHERE keyframe = v.keyframe) AND NOT deleted;
"""

Point = list[float]


@dataclass(frozen=True)
class KeyFrame:
    """The state of a key frame."""

    keyframe: str
    """``<grasp>:<frame>``, the same for all tabs."""
    task: str
    annotator: str
    grasp: str
    """Its mark."""
    frame: int
    joints: Json = field(default_factory=dict)
    """Points by joint number, "0" to "20", or ``UNSEEN_JOINT``."""
    outlines: Json = field(default_factory=dict)
    """Polygons by a name that the page makes: ``of``, ``closed`` and ``points``."""
    hidden: bool = False
    """The object is not visible."""
    deleted: bool = False

    def polygons(self, kind: str) -> Polygons:
        """Return the closed shapes of a kind."""
        shapes = [one["points"] for one in self.outlines.values() if one["of"] == kind and one["closed"]]
        return tuple(np.array(points, dtype=float) for points in shapes)

    def labels(self) -> FrameLabels:
        """Return the labels of a label file."""
        shapes = {kind: self.polygons(kind) or None for kind in MIN_SHAPE_POINTS}
        if self.hidden and shapes["object"] is None:
            shapes["object"] = ()
        if all(point == UNSEEN_JOINT for point in self.joints.values()):
            return FrameLabels(None, **shapes)
        points = [self.joints.get(str(n), UNSEEN_JOINT) for n in range(N_KEYFRAME_JOINTS)]
        return FrameLabels(np.array([[math.nan] * 2 if point == UNSEEN_JOINT else point for point in points]), **shapes)


KEYFRAME_COLUMNS = tuple(one.name for one in fields(KeyFrame))


def keyframe_versions(database: VersionDatabase) -> Versions[KeyFrame]:
    """Return the key frames in a database."""
    columns = "keyframe", "grasp", "task, annotator, grasp, frame", KEYFRAME_COLUMNS
    return Versions(database, "keyframe_versions", "keyframes", *columns, _keyframe_to_row, _keyframe_from_row)


def blank_keyframe(task: str, annotator: str, grasp: str, frame: int) -> KeyFrame:
    """Make a key frame without labels."""
    return KeyFrame(f"{grasp}:{frame}", task, annotator, grasp, frame)


def change_from_labels(frame: FrameLabels) -> Json:
    """Return the values that give a blank key frame the labels of a file."""
    points = () if frame.joints is None else frame.joints
    joints = {str(n): UNSEEN_JOINT if np.isnan(point).any() else point.tolist() for n, point in enumerate(points)}
    shapes = [(kind, shape) for kind in MIN_SHAPE_POINTS for shape in getattr(frame, kind) or ()]
    outlines = {
        f"outline-{n:04d}": {"of": kind, "closed": True, "points": shape.tolist()}
        for n, (kind, shape) in enumerate(shapes)
    }
    return {"joints": joints, "outlines": outlines, "hidden": frame.object == ()}


def apply_keyframe_change(keyframe: KeyFrame, sets: Json, size: tuple[int, int]) -> KeyFrame:
    """Apply a change to a key frame of an image of a ``size`` (width, height) [px]. Raises ``RefusedError``."""
    for key in ("hidden", "deleted"):
        if not isinstance(sets.get(key, False), bool):
            raise RefusedError(f"{key} must be true or false (got {shorten_value(sets[key])})")
    if sets.get("deleted"):
        return replace(keyframe, deleted=True)
    new = keyframe
    if keyframe.deleted:
        new = blank_keyframe(keyframe.task, keyframe.annotator, keyframe.grasp, keyframe.frame)
    joints = _changed_values(new.joints, sets, "joints", _checked_joint, size)
    outlines = _changed_values(new.outlines, sets, "outlines", _checked_outline, size)
    new = replace(new, joints=joints, outlines=outlines, hidden=sets.get("hidden", new.hidden))
    for kind in MIN_SHAPE_POINTS:
        if sum(one["of"] == kind for one in new.outlines.values()) > MAX_POLYGONS_PER_KIND:
            raise RefusedError(f"outlines must be at most {MAX_POLYGONS_PER_KIND} of one kind on a frame")
    return new if new.joints or new.outlines or new.hidden else replace(new, deleted=True)


def _changed_values(
    old: Json, sets: Json, name: str, check: Callable[[str, object, tuple[int, int]], object], size: tuple[int, int]
) -> Json:
    """Check and apply the new values of a field; null removes a value."""
    if not isinstance(changed := sets.get(name, {}), dict):
        raise RefusedError(f"{name} must be an object (got {shorten_value(changed)})")
    values = old | {key: check(key, value, size) for key, value in changed.items()}
    return {key: value for key, value in values.items() if value is not None}


def _checked_joint(key: str, value: object, size: tuple[int, int]) -> Point | str | None:
    if key not in map(str, range(N_KEYFRAME_JOINTS)):
        raise RefusedError(f"joints must be numbers 0 to {N_KEYFRAME_JOINTS - 1} (got {shorten_value(key)})")
    if value is None or value == UNSEEN_JOINT:
        return None if value is None else UNSEEN_JOINT
    return _checked_point(value, size)


def _checked_outline(key: str, value: object, size: tuple[int, int]) -> Json | None:
    if not TOKEN_PATTERN.fullmatch(key):
        raise RefusedError(f"outlines must be 8 to 64 letters, digits or hyphens (got {shorten_value(key)})")
    if value is None:
        return None
    if not isinstance(value, dict) or value.keys() != {"of", "closed", "points"}:
        raise RefusedError(f"outline must be of, closed and points (got {shorten_value(value)})")
    if value["of"] not in tuple(MIN_SHAPE_POINTS) or not isinstance(value["closed"], bool):
        kinds = ", ".join(MIN_SHAPE_POINTS)
        raise RefusedError(f"outline must be one of {kinds}, closed or not (got {shorten_value(value)})")
    points, least = value["points"], MIN_SHAPE_POINTS[value["of"]] if value["closed"] else 1
    if not isinstance(points, list) or not least <= len(points) <= MAX_LABEL_POLYGON_CORNERS:
        number = f"{least} to {MAX_LABEL_POLYGON_CORNERS}"
        raise RefusedError(f"outline must be {number} points (got {shorten_value(points)})")
    return value | {"points": [_checked_point(point, size) for point in points]}


def _checked_point(value: object, size: tuple[int, int]) -> Point:
    """Check a point in the image, or outside it by no more than the image's size; round it to 0.01 pixels."""
    numbers = isinstance(value, list) and len(value) == 2 and all(type(x) in (int, float) for x in value)
    if not numbers or not isinstance(value, list):
        raise RefusedError(f"point must be [x, y] (got {shorten_value(value)})")
    if not all(-side <= x <= 2 * side for x, side in zip(value, size, strict=True)):  # false for NaN, too
        image = f"{size[0]} x {size[1]} image"
        raise RefusedError(f"point must be one in or about the {image} (got {shorten_value(value)})")
    return [round(float(x), 2) for x in value]


def _keyframe_to_row(keyframe: KeyFrame) -> Row:
    return tuple(json.dumps(value) if isinstance(value, dict) else value for value in asdict(keyframe).values())


def _keyframe_from_row(row: Row) -> KeyFrame:
    values = dict(zip(KEYFRAME_COLUMNS, row, strict=True))
    parsed = {key: json.loads(values[key]) for key in ("joints", "outlines")}
    for key, value in parsed["joints"].items():
        _checked_joint(key, value, MAX_KEYFRAME_SIZE_PX)
    for key, value in parsed["outlines"].items():
        _checked_outline(key, value, MAX_KEYFRAME_SIZE_PX)
    return KeyFrame(**values | parsed | {key: bool(values[key]) for key in ("hidden", "deleted")})
