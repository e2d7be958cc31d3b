"""VISOR (Darkhalil et al., NeurIPS 2022): polygons and contacts of hands and objects in EPIC-KITCHENS.

One JSON file for each video: sparse annotations by people (``P01_01.json``, polygons in 1920 x 1080 pixels) and dense
ones interpolated between them (``P01_01_interpolations.json``, 854 x 480), both

    {"video_annotations": [{"image": {"name", "video", ...}, "annotations": [{"id", "name", "class_id", "segments",
    "in_contact_object", "on_which_hand", ...}]}]}

VISOR's images were extracted from the videos anew, so its frame numbers are a few frames off EPIC's.
``frame_mapping.json`` has EPIC's images of sparse frames, {video: {VISOR's image: EPIC's image}}; dense frames have the
difference of the nearer sparse frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io.arrays import from_lists
from getagrip.io.files import printable, shorten_value
from getagrip.readers import streams

SPARSE_IMAGE_SIZE_PX, DENSE_IMAGE_SIZE_PX = (1920, 1080), (854, 480)
"""Width and height of the images of sparse and of dense polygons [px]."""
SIDE_BY_HAND_CLASS: dict[int, Side] = {300: "left", 301: "right"}
SIDE_BY_GLOVE_CLASS: dict[int, Side] = {303: "left", 304: "right"}
"""Classes of hands, and of worn gloves; other gloves have another class."""
SIDE_BY_HAND_NAME: dict[str, Side] = {"left hand": "left", "right hand": "right"}
NO_CONTACT_VALUES = ("hand-not-in-contact", "glove-not-in-contact")
UNKNOWN_CONTACT_VALUES = ("none-of-the-above", "inconclusive", "None")
"""Values instead of the id of a touched object: no contact; an object without a mask, or disagreeing annotators."""
MAX_ANNOTATION_POINTS = 100_000
"""Maximum number of points of an annotation's polygons."""
MAX_ANNOTATION_NAME_LENGTH = 200
FRAME_MAPPING_FILE = "frame_mapping.json"
NO_FRAME_MAPPING_NOTE = f"no {FRAME_MAPPING_FILE} beside VISOR's files: its frame numbers are a few frames off EPIC's"


@dataclass(frozen=True, eq=False)  # two objects may have equal annotations, and arrays have no truth value of ==
class Annotation:
    """A hand or an object in an image."""

    id: str
    name: str
    """Free text, as "olive oil bottle"."""
    class_id: int | None
    """EPIC-100's noun class, or VISOR's for hands and gloves."""
    polygons: tuple[Float[ndarray, "_P 2"], ...]
    """Corners (x, y) [px of the frame's ``size``]."""
    hands: tuple[Side, ...]
    """Sides of a hand or glove: one, both for a pair of gloves in one mask, none for objects."""
    touches: str | None
    """For hands: the id of the object in contact, "" for none, None if unknown."""


@dataclass(frozen=True)
class VisorFrame:
    """The annotations of one image."""

    number: int
    """VISOR's frame number."""
    dense: bool
    """True for interpolated annotations, in 854 x 480 pixels."""
    annotations: tuple[Annotation, ...]
    ends: tuple[int, int] | None = None
    """For dense annotations: the two interpolated frames, by VISOR's numbers."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the polygons' image [px]."""
        return DENSE_IMAGE_SIZE_PX if self.dense else SPARSE_IMAGE_SIZE_PX


@dataclass(frozen=True)
class FrameMapping:
    """EPIC's frame numbers for VISOR's, of one video."""

    epic: dict[int, int]
    """EPIC's numbers of sparse frames; empty without a mapping: equal numbers are assumed."""

    def number(self, frame: VisorFrame) -> int:
        """Return EPIC's number of a frame; a dense frame is shifted like the nearer of its two ends."""
        known = [n for n in (frame.number, *(frame.ends or ())) if n in self.epic]
        if not known:
            return frame.number
        near = min(known, key=lambda n: abs(n - frame.number))
        return frame.number + self.epic[near] - near


def find_mapping(folder: Path) -> Path | None:
    """Find the ``frame_mapping.json`` in a folder or below; None without one."""
    return next(iter(sorted(folder.rglob(FRAME_MAPPING_FILE))), None)


def read_mapping(path: Path | None, video: str) -> FrameMapping:
    """Read the frame numbers of a video; equal numbers without a file. Raises ``InputError``."""
    if path is None:
        return FrameMapping({})
    value = streams.read_json_member(path, video)
    named = {a: (b, f"{video}.{printable(a)}") for a, b in value.items()}
    return FrameMapping({_frame_number(path, video, a): _frame_number(path, key, b) for a, (b, key) in named.items()})


def find_visor_files(folder: Path) -> dict[str, list[Path]]:
    """Find VISOR's files by video, anywhere below a folder.

    ``<video>.json`` and ``<video>_interpolations.json``, or a ``.zip`` of the latter. Raises ``InputError``.
    """
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("P*")):
        named = re.fullmatch(r"(P\d{2}_\d{2,3})(_interpolations)?(\.json|\.zip)", path.name)
        if named is None or (named[3] == ".zip" and not named[2]):  # P01_01.zip: images
            continue
        if path.with_suffix(".json") not in found.get(named[1], ()):
            found.setdefault(named[1], []).append(path)
    if not found:
        raise InputError(folder, "", "no <video>.json or <video>_interpolations.json in it", "VISOR's annotations")
    return found


def is_dense(path: Path) -> bool:
    """Return whether a VISOR file holds interpolated annotations."""
    return path.stem.endswith("_interpolations")


def read_frames(path: Path) -> Iterator[VisorFrame]:
    """Yield the frames of a VISOR file, one at a time in memory. Raises ``InputError``."""
    dense = is_dense(path)
    for n, item in enumerate(streams.stream_items(path, "video_annotations")):
        key = f"video_annotations[{n}]"
        image, annotations = item.get("image"), item.get("annotations")
        if not isinstance(image, dict):
            raise InputError(path, f"{key}.image", shorten_value(image), "an object")
        if not isinstance(annotations, list):
            raise InputError(path, f"{key}.annotations", shorten_value(annotations), "a list")
        number = _frame_number(path, f"{key}.image.name", image.get("name"))
        found = [_parse_annotation(path, f"{key}.annotations[{k}]", a, dense) for k, a in enumerate(annotations)]
        ends = [image.get(f"interpolation_{end}_frame") for end in ("start", "end")] if dense else [None]
        if None in ends:
            yield VisorFrame(number, dense, tuple(found))
        else:
            first, last = (_frame_number(path, f"{key}.image", end) for end in ends)
            yield VisorFrame(number, dense, tuple(found), (first, last))


def _frame_number(path: Path, key: str, name: object) -> int:
    """Return the number in the name of an image, as ``P01_01_frame_0000000140.jpg``."""
    named = re.fullmatch(r"(?:[\w.-]*/)*(?:P\d{2}_\d{2,3}_)?frame_(\d{1,10})\.(?:jpg|png)", str(name))
    if not isinstance(name, str) or named is None:
        raise InputError(path, key, shorten_value(name), "the name of an image, as P01_01_frame_0000000140.jpg")
    return int(named[1])


def _parse_annotation(path: Path, key: str, value: object, dense: bool) -> Annotation:
    if not isinstance(value, dict):
        raise InputError(path, key, shorten_value(value), "an object")
    name, class_id = value.get("name"), value.get("class_id")
    if not isinstance(name, str) or not name.strip() or len(name) > MAX_ANNOTATION_NAME_LENGTH:
        raise InputError(path, f"{key}.name", shorten_value(name), "a name")
    if not (class_id is None or type(class_id) is int):
        raise InputError(path, f"{key}.class_id", shorten_value(class_id), "a whole number")
    hands = _annotated_hand_sides(name, class_id, value.get("on_which_hand"))
    size = DENSE_IMAGE_SIZE_PX if dense else SPARSE_IMAGE_SIZE_PX
    polygons = _parse_visor_polygons(path, f"{key}.segments", value.get("segments"), size)
    touches = _parse_touched_id(value.get("in_contact_object")) if hands else None
    return Annotation(str(value.get("id", "")), name.strip(), class_id, polygons, hands, touches)


def _annotated_hand_sides(name: str, class_id: int | None, on: object) -> tuple[Side, ...]:
    """Return the sides of a hand, or of the hands that wear a glove."""
    if class_id in SIDE_BY_HAND_CLASS:
        return (SIDE_BY_HAND_CLASS[class_id],)
    if name in SIDE_BY_HAND_NAME:  # dense files may lack classes
        return (SIDE_BY_HAND_NAME[name],)
    worn = on if isinstance(on, list) else [on]  # a side, a list of them, "inconclusive", or no such key
    stated = tuple(SIDE_BY_HAND_NAME[side] for side in worn if isinstance(side, str) and side in SIDE_BY_HAND_NAME)
    return stated or ((SIDE_BY_GLOVE_CLASS[class_id],) if class_id in SIDE_BY_GLOVE_CLASS else ())


def _parse_touched_id(value: object) -> str | None:
    if not isinstance(value, str) or value in UNKNOWN_CONTACT_VALUES:
        return None
    return "" if value in NO_CONTACT_VALUES else value


def _parse_visor_polygons(
    path: Path, key: str, value: object, size: tuple[int, int]
) -> tuple[Float[ndarray, "_P 2"], ...]:
    """Parse the corners of polygons, without empty polygons; corners may exceed the image by its size."""
    if not isinstance(value, list) or not all(isinstance(polygon, list) for polygon in value):
        raise InputError(path, key, shorten_value(value), "a list of polygons, [[[x, y], ...], ...]")
    if sum(map(len, value)) > MAX_ANNOTATION_POINTS:
        raise InputError(path, key, f"{sum(map(len, value))} corners", f"at most {MAX_ANNOTATION_POINTS}")
    polygons = []
    for k, polygon in enumerate(value):
        if not polygon:
            continue
        points = from_lists(polygon)
        if points is None or points.dtype.kind not in "fi" or points.ndim != 2 or points.shape[1] != 2:
            raise InputError(path, f"{key}[{k}]", shorten_value(polygon), "corners [x, y]")
        if not np.all((points >= -np.array(size)) & (points <= 2 * np.array(size))):  # false for infinite ones too
            expected = f"corners in or about the {size[0]} x {size[1]} image"
            raise InputError(path, f"{key}[{k}]", f"corners from {points.min():g} to {points.max():g}", expected)
        polygons.append(points.astype(np.float32))
    return tuple(polygons)


def draw_visor_mask(
    annotations: Iterable[Annotation], drawn_size: tuple[int, int], size: tuple[int, int]
) -> Bool[ndarray, "H W"]:
    """Draw annotations with polygons in an image of ``drawn_size`` (width, height), resized to ``size``.

    As in VISOR's code: corners truncated to whole pixels, borders included, the polygons of an annotation even-odd,
    and the nearest pixel in resizing.
    """
    import cv2

    out = np.zeros(drawn_size[::-1], np.uint8)
    for annotation in annotations:
        if annotation.polygons:
            cv2.fillPoly(out, [polygon.astype(np.int32) for polygon in annotation.polygons], 1)
    if drawn_size != size:
        out = np.asarray(cv2.resize(out, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return out.astype(bool)
