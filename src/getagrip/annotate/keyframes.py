"""A key frame: what one person has clicked on one frame of a grasp, the joints of the hand and polygons.

A change names the joints and polygons (``outlines``) that it touches; null takes one away:

    {"joints": {"4": [x, y], "5": "unseen", "6": null},
     "outlines": {"<its name>": {"of": "object", "closed": true, "points": [[x, y], ...]}},
     "hidden": false, "deleted": false}

An outline is "of" the object, of what is in "front" or of the "hand"; or it is a stroke "on" the object or "off" it,
which is always closed, that is done.

Points are in pixels of the footage, the middle of its first pixel at (0.5, 0.5).
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.annotate.footage import MAX_FOOTAGE_SIDE_PX
from getagrip.annotate.labels import (
    MAX_LABEL_POLYGON_CORNERS,
    MAX_POLYGONS_PER_KIND,
    MIN_SHAPE_POINTS,
    FrameLabels,
    Polygons,
)
from getagrip.annotate.versions import TOKEN_PATTERN, RefusedError, Row, VersionDatabase, Versions
from getagrip.io.files import Json, shorten_value

KEYFRAME_SETTABLE_FIELDS = frozenset({"joints", "outlines", "hidden", "deleted"})
"""Fields that the page may change."""
UNSEEN_JOINT = "unseen"
"""A joint that a person has looked for and not found, so that the next one is asked for."""
N_KEYFRAME_JOINTS = 21
MAX_KEYFRAME_SIZE_PX = (MAX_FOOTAGE_SIDE_PX, MAX_FOOTAGE_SIDE_PX)
"""Size for images whose size is not at hand."""
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
    """``<grasp>:<frame>``: two tabs that begin the same one mean the same."""
    task: str
    annotator: str
    grasp: str
    """The mark that it belongs to."""
    frame: int
    joints: Json = field(default_factory=dict)
    """By number, "0" to "20": a point, or ``UNSEEN_JOINT``."""
    outlines: Json = field(default_factory=dict)
    """Polygons by a name that the page chooses: ``of``, ``closed`` and ``points``."""
    hidden: bool = False
    """The object is not visible."""
    deleted: bool = False

    def polygons(self, kind: str) -> Polygons:
        """Return the closed shapes of a kind."""
        shapes = [one["points"] for one in self.outlines.values() if one["of"] == kind and one["closed"]]
        return tuple(np.array(points, dtype=float) for points in shapes)

    def labels(self) -> FrameLabels:
        """Return its labels, as a file has them."""
        shapes = {kind: self.polygons(kind) or None for kind in MIN_SHAPE_POINTS}
        if self.hidden and shapes["object"] is None:
            shapes["object"] = ()
        clicked = any(point != UNSEEN_JOINT for point in self.joints.values())
        return FrameLabels(self._joints() if clicked else None, **shapes)

    def _joints(self) -> Float[ndarray, "21 2"]:
        points = [self.joints.get(str(n), UNSEEN_JOINT) for n in range(N_KEYFRAME_JOINTS)]
        return np.array([[math.nan] * 2 if point == UNSEEN_JOINT else point for point in points])


KEYFRAME_COLUMNS = tuple(one.name for one in fields(KeyFrame))


def keyframe_versions(database: VersionDatabase) -> Versions[KeyFrame]:
    """Return the key frames in a database."""
    order = "task, annotator, grasp, frame"
    return Versions(
        database,
        "keyframe_versions",
        "keyframes",
        "keyframe",
        "grasp",
        order,
        KEYFRAME_COLUMNS,
        _keyframe_to_row,
        _keyframe_from_row,
    )


def blank_keyframe(task: str, annotator: str, grasp: str, frame: int) -> KeyFrame:
    """Make a frame without labels."""
    return KeyFrame(f"{grasp}:{frame}", task, annotator, grasp, frame)


def change_from_labels(frame: FrameLabels) -> Json:
    """Return the change that gives a blank key frame the labels of a file."""
    joints = {} if frame.joints is None else {
        str(n): UNSEEN_JOINT if np.isnan(point).any() else point.tolist() for n, point in enumerate(frame.joints)
    }  # fmt: skip
    shapes = [(kind, shape) for kind in MIN_SHAPE_POINTS for shape in getattr(frame, kind) or ()]
    outlines = {
        f"outline-{n:04d}": {"of": kind, "closed": True, "points": shape.tolist()}
        for n, (kind, shape) in enumerate(shapes)
    }
    return {"joints": joints, "outlines": outlines, "hidden": frame.object == ()}


def apply_keyframe_change(keyframe: KeyFrame, sets: Json, size: tuple[int, int]) -> KeyFrame:
    """Apply a change to a key frame on an image of some width and height. Raises ``RefusedError``."""
    for key in ("hidden", "deleted"):
        if not isinstance(sets.get(key, False), bool):
            raise RefusedError(f"{key} must be true or false (got {shorten_value(sets[key])})")
    if sets.get("deleted"):
        return replace(keyframe, deleted=True)
    old = (
        blank_keyframe(keyframe.task, keyframe.annotator, keyframe.grasp, keyframe.frame)
        if keyframe.deleted
        else keyframe
    )
    new = replace(
        old,
        joints=old.joints
        | {key: _checked_joint(key, value, size) for key, value in _checked_object(sets, "joints").items()},
        outlines=old.outlines
        | {key: _checked_outline(key, value, size) for key, value in _checked_object(sets, "outlines").items()},
        hidden=sets.get("hidden", old.hidden),
    )
    new = replace(new, joints=_drop_nulls(new.joints), outlines=_drop_nulls(new.outlines))
    for kind in MIN_SHAPE_POINTS:
        if sum(one["of"] == kind for one in new.outlines.values()) > MAX_POLYGONS_PER_KIND:
            raise RefusedError(f"outlines must be at most {MAX_POLYGONS_PER_KIND} of one kind on a frame")
    return new if new.joints or new.outlines or new.hidden else replace(new, deleted=True)


def _checked_object(sets: Json, key: str) -> Json:
    value = sets.get(key, {})
    if not isinstance(value, dict):
        raise RefusedError(f"{key} must be an object (got {shorten_value(value)})")
    return value


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
        raise RefusedError(
            f"outline must be one of {', '.join(MIN_SHAPE_POINTS)}, closed or not (got {shorten_value(value)})"
        )
    points, least = value["points"], MIN_SHAPE_POINTS[value["of"]] if value["closed"] else 1
    if not isinstance(points, list) or not least <= len(points) <= MAX_LABEL_POLYGON_CORNERS:
        raise RefusedError(
            f"outline must be {least} to {MAX_LABEL_POLYGON_CORNERS} points (got {shorten_value(points)})"
        )
    return value | {"points": [_checked_point(point, size) for point in points]}


def _checked_point(value: object, size: tuple[int, int]) -> Point:
    """Check a point in the image, or beside it by no more than the image's own size, to a hundredth of a pixel."""
    numbers = isinstance(value, list) and len(value) == 2 and all(type(x) in (int, float) for x in value)
    if not numbers or not isinstance(value, list):
        raise RefusedError(f"point must be [x, y] (got {shorten_value(value)})")
    if not all(-side <= x <= 2 * side for x, side in zip(value, size, strict=True)):  # false for NaN, too
        raise RefusedError(
            f"point must be one in or about the {size[0]} x {size[1]} image (got {shorten_value(value)})"
        )
    return [round(float(x), 2) for x in value]


def _drop_nulls(values: Json) -> Json:
    return {key: value for key, value in values.items() if value is not None}


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
