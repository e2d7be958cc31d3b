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

from getagrip.annotate.footage import LARGEST_SIDE
from getagrip.annotate.labels import MOST_CORNERS, MOST_POLYGONS, SHAPES, FrameLabels, Polygons
from getagrip.annotate.versions import TOKEN, Database, RefusedError, Row, Versions
from getagrip.io.files import Json, shown

SETTABLE = frozenset({"joints", "outlines", "hidden", "deleted"})
"""Fields that the page may change."""
UNSEEN = "unseen"
"""A joint that a person has looked for and not found, so that the next one is asked for."""
JOINTS = 21
ANY_SIZE = (LARGEST_SIDE, LARGEST_SIDE)
"""Size for images whose size is not at hand."""
SCHEMA = """
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
    """By number, "0" to "20": a point, or ``UNSEEN``."""
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
        shapes = {kind: self.polygons(kind) or None for kind in SHAPES}
        if self.hidden and shapes["object"] is None:
            shapes["object"] = ()
        clicked = any(point != UNSEEN for point in self.joints.values())
        return FrameLabels(self._joints() if clicked else None, **shapes)

    def _joints(self) -> Float[ndarray, "21 2"]:
        points = [self.joints.get(str(n), UNSEEN) for n in range(JOINTS)]
        return np.array([[math.nan] * 2 if point == UNSEEN else point for point in points])


COLUMNS = tuple(one.name for one in fields(KeyFrame))


def versions(database: Database) -> Versions[KeyFrame]:
    """Return the key frames in a database."""
    order = "task, annotator, grasp, frame"
    return Versions(database, "keyframe_versions", "keyframes", "keyframe", "grasp", order, COLUMNS, _row, _keyframe)


def blank(task: str, annotator: str, grasp: str, frame: int) -> KeyFrame:
    """Make a frame without labels."""
    return KeyFrame(f"{grasp}:{frame}", task, annotator, grasp, frame)


def from_labels(frame: FrameLabels) -> Json:
    """Return the change that gives a blank key frame the labels of a file."""
    joints = {} if frame.joints is None else {
        str(n): UNSEEN if np.isnan(point).any() else point.tolist() for n, point in enumerate(frame.joints)
    }  # fmt: skip
    shapes = [(kind, shape) for kind in SHAPES for shape in getattr(frame, kind) or ()]
    outlines = {
        f"outline-{n:04d}": {"of": kind, "closed": True, "points": shape.tolist()}
        for n, (kind, shape) in enumerate(shapes)
    }
    return {"joints": joints, "outlines": outlines, "hidden": frame.object == ()}


def changed(keyframe: KeyFrame, sets: Json, size: tuple[int, int]) -> KeyFrame:
    """Apply a change to a key frame on an image of some width and height. Raises ``RefusedError``."""
    for key in ("hidden", "deleted"):
        if not isinstance(sets.get(key, False), bool):
            raise RefusedError(f"{key} must be true or false (got {shown(sets[key])})")
    if sets.get("deleted"):
        return replace(keyframe, deleted=True)
    old = blank(keyframe.task, keyframe.annotator, keyframe.grasp, keyframe.frame) if keyframe.deleted else keyframe
    new = replace(
        old,
        joints=old.joints | {key: _joint(key, value, size) for key, value in _object(sets, "joints").items()},
        outlines=old.outlines | {key: _outline(key, value, size) for key, value in _object(sets, "outlines").items()},
        hidden=sets.get("hidden", old.hidden),
    )
    new = replace(new, joints=_without_nothing(new.joints), outlines=_without_nothing(new.outlines))
    for kind in SHAPES:
        if sum(one["of"] == kind for one in new.outlines.values()) > MOST_POLYGONS:
            raise RefusedError(f"outlines must be at most {MOST_POLYGONS} of one kind on a frame")
    return new if new.joints or new.outlines or new.hidden else replace(new, deleted=True)


def _object(sets: Json, key: str) -> Json:
    value = sets.get(key, {})
    if not isinstance(value, dict):
        raise RefusedError(f"{key} must be an object (got {shown(value)})")
    return value


def _joint(key: str, value: object, size: tuple[int, int]) -> Point | str | None:
    if key not in map(str, range(JOINTS)):
        raise RefusedError(f"joints must be numbers 0 to {JOINTS - 1} (got {shown(key)})")
    if value is None or value == UNSEEN:
        return None if value is None else UNSEEN
    return _point(value, size)


def _outline(key: str, value: object, size: tuple[int, int]) -> Json | None:
    if not TOKEN.fullmatch(key):
        raise RefusedError(f"outlines must be 8 to 64 letters, digits or hyphens (got {shown(key)})")
    if value is None:
        return None
    if not isinstance(value, dict) or value.keys() != {"of", "closed", "points"}:
        raise RefusedError(f"outline must be of, closed and points (got {shown(value)})")
    if value["of"] not in tuple(SHAPES) or not isinstance(value["closed"], bool):
        raise RefusedError(f"outline must be one of {', '.join(SHAPES)}, closed or not (got {shown(value)})")
    points, least = value["points"], SHAPES[value["of"]] if value["closed"] else 1
    if not isinstance(points, list) or not least <= len(points) <= MOST_CORNERS:
        raise RefusedError(f"outline must be {least} to {MOST_CORNERS} points (got {shown(points)})")
    return value | {"points": [_point(point, size) for point in points]}


def _point(value: object, size: tuple[int, int]) -> Point:
    """Check a point in the image, or beside it by no more than the image's own size, to a hundredth of a pixel."""
    numbers = isinstance(value, list) and len(value) == 2 and all(type(x) in (int, float) for x in value)
    if not numbers or not isinstance(value, list):
        raise RefusedError(f"point must be [x, y] (got {shown(value)})")
    if not all(-side <= x <= 2 * side for x, side in zip(value, size, strict=True)):  # false for NaN, too
        raise RefusedError(f"point must be one in or about the {size[0]} x {size[1]} image (got {shown(value)})")
    return [round(float(x), 2) for x in value]


def _without_nothing(values: Json) -> Json:
    return {key: value for key, value in values.items() if value is not None}


def _row(keyframe: KeyFrame) -> Row:
    return tuple(json.dumps(value) if isinstance(value, dict) else value for value in asdict(keyframe).values())


def _keyframe(row: Row) -> KeyFrame:
    values = dict(zip(COLUMNS, row, strict=True))
    parsed = {key: json.loads(values[key]) for key in ("joints", "outlines")}
    for key, value in parsed["joints"].items():
        _joint(key, value, ANY_SIZE)
    for key, value in parsed["outlines"].items():
        _outline(key, value, ANY_SIZE)
    return KeyFrame(**values | parsed | {key: bool(values[key]) for key in ("hidden", "deleted")})
