"""VISOR (Darkhalil et al., NeurIPS 2022): who holds what in EPIC-KITCHENS, as polygons.

One JSON file for each video: sparse annotations by people (``P01_01.json``, polygons in 1920 x 1080 pixels) and dense
ones interpolated between them (``P01_01_interpolations.json``, 854 x 480), both

    {"video_annotations": [{"image": {"name", "video", ...}, "annotations": [{"id", "name", "class_id", "segments",
    "in_contact_object", "on_which_hand", ...}]}]}

VISOR took its images out of the videos anew, so its frame numbers are a few off EPIC's. ``frame_mapping.json`` gives
EPIC's for the sparse ones, {video: {VISOR's image: EPIC's image}}; between two of them the difference stays.
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
"""Width and height of the images whose pixels the polygons are in."""
SIDE_BY_HAND_CLASS: dict[int, Side] = {300: "left", 301: "right"}
SIDE_BY_GLOVE_CLASS: dict[int, Side] = {303: "left", 304: "right"}
"""Classes of hands, and of gloves that are worn; one that is not has another class."""
SIDE_BY_HAND_NAME: dict[str, Side] = {"left hand": "left", "right hand": "right"}
NO_CONTACT_VALUES = ("hand-not-in-contact", "glove-not-in-contact")
UNKNOWN_CONTACT_VALUES = ("none-of-the-above", "inconclusive", "None")
"""Instead of the id of what a hand touches: nothing; something without a mask, or the annotators disagree."""
MAX_ANNOTATION_POINTS = 100_000
"""Most points of the polygons of one annotation."""
MAX_ANNOTATION_NAME_LENGTH = 200
FRAME_MAPPING_FILE = "frame_mapping.json"
NO_FRAME_MAPPING_NOTE = f"no {FRAME_MAPPING_FILE} beside VISOR's files: its frame numbers are a few frames off EPIC's"


@dataclass(frozen=True, eq=False)  # two things may be annotated alike, and arrays have no one answer to ==
class Annotation:
    """One thing in an image."""

    id: str
    name: str
    """In open words, as "olive oil bottle"."""
    class_id: int | None
    """EPIC-100's noun class, or VISOR's for hands and gloves."""
    polygons: tuple[Float[ndarray, "_P 2"], ...]
    """Corners (x, y) in pixels of the frame's ``size``."""
    hands: tuple[Side, ...]
    """Which hands it is (or is worn on): one, both for a pair of gloves in one mask, or none for objects."""
    touches: str | None
    """For hands: the id of the object in contact, "" for none, None where that is unknown."""


@dataclass(frozen=True)
class VisorFrame:
    """The annotations of one image."""

    number: int
    """VISOR's own."""
    dense: bool
    """Interpolated, in 854 x 480 pixels."""
    annotations: tuple[Annotation, ...]
    ends: tuple[int, int] | None = None
    """For dense annotations: the frames between which it was interpolated, VISOR's numbers."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image whose pixels the polygons are in."""
        return DENSE_IMAGE_SIZE_PX if self.dense else SPARSE_IMAGE_SIZE_PX


@dataclass(frozen=True)
class FrameMapping:
    """EPIC's frame numbers for VISOR's, of one video."""

    epic: dict[int, int]
    """EPIC's numbers of sparse frames; empty without a mapping: then the same numbers are assumed."""

    def number(self, frame: VisorFrame) -> int:
        """Return EPIC's number of a frame: its own or, for a dense frame, moved as the nearer of its two ends is."""
        known = [n for n in (frame.number, *(frame.ends or ())) if n in self.epic]
        if not known:
            return frame.number
        near = min(known, key=lambda n: abs(n - frame.number))
        return frame.number + self.epic[near] - near


def find_mapping(folder: Path) -> Path | None:
    """Find the ``frame_mapping.json`` in a folder or below, where there is one."""
    return next(iter(sorted(folder.rglob(FRAME_MAPPING_FILE))), None)


def read_mapping(path: Path | None, video: str) -> FrameMapping:
    """Read the frame numbers of a video; the same numbers without a file.

    Raises ``InputError``, also without the video.
    """
    if path is None:
        return FrameMapping({})
    value = streams.read_json_member(path, video)
    named = {a: (b, f"{video}.{printable(a)}") for a, b in value.items()}
    return FrameMapping({_frame_number(path, video, a): _frame_number(path, key, b) for a, (b, key) in named.items()})


def find_visor_files(folder: Path) -> dict[str, list[Path]]:
    """Find VISOR's files by video, anywhere below a folder.

    They are ``<video>.json`` and ``<video>_interpolations.json``, or a ``.zip`` of the latter. Raises ``InputError``
    where there is none.
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
    """Return whether a file of VISOR's holds interpolated annotations."""
    return path.stem.endswith("_interpolations")


def read_frames(path: Path) -> Iterator[VisorFrame]:
    """Yield the frames of one of VISOR's files, one at a time in memory. Raises ``InputError``."""
    dense = is_dense(path)
    for n, item in enumerate(streams.stream_items(path, "video_annotations")):
        key = f"video_annotations[{n}]"
        image, annotations = item.get("image"), item.get("annotations")
        if not isinstance(image, dict):
            raise InputError(path, f"{key}.image", shorten_value(image), "an object")
        if not isinstance(annotations, list):
            raise InputError(path, f"{key}.annotations", shorten_value(annotations), "a list")
        ends = [image.get(f"interpolation_{end}_frame") for end in ("start", "end")] if dense else [None]
        yield VisorFrame(
            _frame_number(path, f"{key}.image.name", image.get("name")),
            dense,
            tuple(_parse_annotation(path, f"{key}.annotations[{k}]", a, dense) for k, a in enumerate(annotations)),
            None
            if None in ends
            else (
                _frame_number(path, f"{key}.image", ends[0]),
                _frame_number(path, f"{key}.image", ends[1]),
            ),
        )


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
    return Annotation(
        str(value.get("id", "")),
        name.strip(),
        class_id,
        _parse_visor_polygons(
            path, f"{key}.segments", value.get("segments"), DENSE_IMAGE_SIZE_PX if dense else SPARSE_IMAGE_SIZE_PX
        ),
        hands,
        _parse_touched_id(value.get("in_contact_object")) if hands else None,
    )


def _annotated_hand_sides(name: str, class_id: int | None, on: object) -> tuple[Side, ...]:
    """Which hands an annotation is, or is worn on."""
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
    """Corners of polygons, without those that have no corner; they may leave the image by its own size."""
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
    annotations: Iterable[Annotation], value: tuple[int, int], size: tuple[int, int]
) -> Bool[ndarray, "H W"]:
    """Draw annotations whose polygons are in an image of ``given`` (width, height), in one of ``size``.

    Drawn as VISOR's own code does: corners cut down to whole pixels, borders included, the polygons of one annotation
    even-odd, and images of another size made by taking the nearest pixel.
    """
    import cv2

    out = np.zeros(value[::-1], np.uint8)
    for annotation in annotations:
        if annotation.polygons:
            cv2.fillPoly(out, [polygon.astype(np.int32) for polygon in annotation.polygons], 1)
    if value != size:
        out = np.asarray(cv2.resize(out, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return out.astype(bool)
