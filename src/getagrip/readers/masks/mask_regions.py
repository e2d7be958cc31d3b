"""Masks from labelled regions, polygons or run lengths, of COCO, YouTube-VIS, SA-V, LabelMe and YOLO.

A pixel belongs to a polygon if its centre is inside, and along the border within half a pixel (``cv2.fillPoly``, to
1/256 px). Run lengths go down the columns, beginning with pixels outside; compressed ones are COCO's texts. Not
pycocotools (2.0.11): runs that end early leave stray memory in its masks, and a random text can abort the process.

A region is chosen by its label. Of several instances of a label, as two cups, one is chosen by its number, ``cup:7``;
``cup:all`` joins them.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip.clip import FrameMasks
from getagrip.clip.match_frames import MAX_NAMES_IN_ERROR
from getagrip.errors import InputError
from getagrip.io import arrays, files
from getagrip.io.files import printable, shorten_value
from getagrip.io.images import decode_image
from getagrip.readers.masks.mask_request import MaskReader, MaskRequest, combine_hand_object_masks

MAX_REGION_CORNERS = 100_000
"""Maximum number of corners of a region's polygons."""
MAX_NESTED_POLYGONS = 1000
"""Maximum number of polygons of a region with holes; with more, all are filled."""
N_INSIDE_TEST_CORNERS = 16
"""Number of corners by which a polygon is tested to be inside another."""
NESTED_POLYGONS_NOTE = "polygons inside others of their region were filled (holes are wound the other way)"
MAX_DRAWN_PIXELS = 2**30
"""Maximum number of pixels to draw for the regions of one kind in a frame, or for the polygons of a region."""


def fill_polygons(
    path: Path, key: str, value: object, size: tuple[int, int], notes: Counter[str] | None = None
) -> Bool[ndarray, "H W"]:
    """Fill polygons [[x, y, x, y, ...], ...], clipped to the image. Raises ``InputError``.

    Corners may exceed the image by its size. A polygon inside another one and wound the other way is a hole; ``notes``
    counts nested polygons wound the same way, which are filled.
    """
    width, height = size
    if not isinstance(value, list) or not all(isinstance(corners, list) for corners in value):
        raise InputError(path, key, shorten_value(value), "polygons, [[x, y, x, y, ...], ...]")
    if sum(map(len, value)) > 2 * MAX_REGION_CORNERS:
        raise InputError(path, key, f"{sum(map(len, value)) // 2} corners", f"at most {MAX_REGION_CORNERS}")
    found, drawn = list[Float[ndarray, "n 2"]](), 0
    for corners in value:
        points = arrays.from_lists(corners)
        if points is None or points.dtype.kind not in "fi" or points.ndim != 1 or len(points) < 6 or len(points) % 2:
            raise InputError(path, key, shorten_value(corners), "at least three corners x, y, x, y, x, y")
        points = points.reshape(-1, 2).astype(float)
        if not np.all((points >= -np.array(size)) & (points <= 2 * np.array(size))):  # false for NaN, too
            bad = f"corners from {points.min():g} to {points.max():g}"
            raise InputError(path, key, bad, f"corners in or about the {width} x {height} image")
        drawn += int(np.prod(np.clip(np.ptp(points, axis=0), 1, size)))
        if drawn > MAX_DRAWN_PIXELS:
            raise InputError(path, key, "polygons of more pixels", f"at most {MAX_DRAWN_PIXELS} pixels in all")
        found.append(points)
    return _draw_polygons(found, size, Counter() if notes is None else notes)


def _draw_polygons(
    found: list[Float[ndarray, "n 2"]], size: tuple[int, int], notes: Counter[str]
) -> Bool[ndarray, "H W"]:
    """Draw polygons, the largest first, so that holes are drawn after their outer polygon."""
    import cv2

    out = np.zeros(size[::-1], np.uint8)
    areas = [_signed_area(points) for points in found]
    outer = list[int]()
    for k in sorted(range(len(found)), key=lambda k: -abs(areas[k])):
        corners = [np.round(256.0 * (found[k] - 0.5)).astype(np.int32)]
        around = [n for n in outer if len(outer) <= MAX_NESTED_POLYGONS and _is_inside(found[k], found[n])]
        if not around or areas[k] * areas[around[-1]] > 0.0:
            notes.update([NESTED_POLYGONS_NOTE] * bool(around))
            cv2.fillPoly(out, corners, 1, shift=8)
        else:
            hole = np.zeros_like(out)
            cv2.fillPoly(hole, corners, 1, shift=8)
            cv2.polylines(hole, corners, True, 0, shift=8)  # the border is the region's
            out[hole > 0] = 0
        outer.append(k)
    return out.astype(bool)


def _signed_area(points: Float[ndarray, "n 2"]) -> float:
    """Compute the area of a polygon, below 0 if it is wound the other way."""
    x, y = (points - points[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0


def _is_inside(points: Float[ndarray, "n 2"], outer: Float[ndarray, "m 2"]) -> bool:
    """Return whether some corners of a polygon are all inside another one."""
    import cv2

    if (points.min(axis=0) < outer.min(axis=0)).any() or (points.max(axis=0) > outer.max(axis=0)).any():
        return False
    border = outer.astype(np.float32)
    some = points[np.linspace(0, len(points) - 1, min(len(points), N_INSIDE_TEST_CORNERS)).astype(int)]
    return all(cv2.pointPolygonTest(border, (float(x), float(y)), False) >= 0.0 for x, y in some)


def decode_run_lengths(path: Path, key: str, value: object, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Decode ``{"size": [height, width], "counts": [...] or "..."}``. Raises ``InputError``."""
    width, height = size
    if not isinstance(value, dict) or value.get("size") != [height, width]:
        shape = value.get("size") if isinstance(value, dict) else value
        raise InputError(path, f"{key}.size", shorten_value(shape), f"[{height}, {width}], the size of the images")
    counts = value.get("counts")
    if isinstance(counts, str):
        counts = _decode_coco_counts(path, key, counts, width * height)
    whole = isinstance(counts, list) and all(type(n) is int and n >= 0 for n in counts)
    if not whole or not isinstance(counts, list) or sum(counts) != width * height:
        got = f"runs of {sum(counts)} pixels" if whole and isinstance(counts, list) else shorten_value(counts)
        raise InputError(path, f"{key}.counts", got, f"runs of {width * height} pixels in all")
    inside = np.arange(len(counts)) % 2 == 1
    return np.repeat(inside, counts).reshape(width, height).T


def _decode_coco_counts(path: Path, key: str, text: str, pixels: int) -> list[int]:
    """Decode COCO's text: numbers in groups of five bits, lowest first, 32 for "more", the highest bit for the sign.

    From the fourth number on, differences from the last number but one (``rleFrString`` of the COCO API).
    """
    counts: list[int] = []
    value = bits = 0
    for letter in text:
        group = ord(letter) - 48
        if not 0 <= group < 64 or bits > 30:
            raise InputError(path, f"{key}.counts", shorten_value(text), "COCO's compressed run lengths")
        value |= (group & 31) << bits
        bits += 5
        if not group & 32:
            if group & 16:
                value -= 1 << bits
            counts.append(value + (counts[-2] if len(counts) > 2 else 0))
            if not 0 <= counts[-1] <= pixels:
                raise InputError(path, f"{key}.counts", f"a run of {counts[-1]} pixels", f"0 to {pixels}")
            value = bits = 0
    if bits:
        raise InputError(path, f"{key}.counts", "run lengths that are cut short", "COCO's compressed run lengths")
    return counts


@dataclass(frozen=True)
class PngRegion:
    """A region as a PNG of its bounding box (LabelMe).

    Attributes:
        content: the PNG file.
        corner: column and row of the first pixel in the image.
    """

    content: bytes
    corner: tuple[int, int]

    def pixels(self, path: Path, key: str, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
        """Decode the region. Raises ``InputError``, also for a box that exceeds the image."""
        inside = decode_image(path, key, self.content, max(size)).any(axis=2)
        (x, y), (height, width) = self.corner, inside.shape
        if min(x, y) < 0 or x + width > size[0] or y + height > size[1]:
            got = f"{width} x {height} pixels from ({x}, {y}) on"
            raise InputError(path, key, got, f"a mask inside the {size[0]} x {size[1]} image")
        out = np.zeros(size[::-1], dtype=bool)
        out[y : y + height, x : x + width] = inside
        return out


def decode_region(
    path: Path, key: str, value: object, size: tuple[int, int], notes: Counter[str] | None = None
) -> Bool[ndarray, "H W"]:
    """Decode a COCO ``segmentation`` of either kind, or a ``PngRegion``. Raises ``InputError``."""
    if isinstance(value, PngRegion):
        return value.pixels(path, key, size)
    if isinstance(value, dict):
        return decode_run_lengths(path, key, value, size)
    return fill_polygons(path, key, value, size, notes)


def run_length_size(value: object) -> tuple[int, int] | None:
    """Return the width and height of run lengths; None for other regions, and for malformed ones."""
    stated = value.get("size") if isinstance(value, dict) else None
    if not isinstance(stated, list) or len(stated) != 2 or not all(type(side) is int for side in stated):
        return None
    return stated[1], stated[0]


def drop_flat_polygons(value: object) -> object:
    """Drop polygons of fewer than three corners or without area from a ``segmentation``."""
    if not isinstance(value, list) or sum(len(one) for one in value if isinstance(one, list)) > 2 * MAX_REGION_CORNERS:
        return value
    return [one for one in value if not _is_flat(one)]


def _is_flat(corners: object) -> bool:
    """Return whether corners, if numbers, are on a line."""
    points = arrays.from_lists(corners) if isinstance(corners, list) else None
    if points is None or points.dtype.kind not in "fi" or points.ndim != 1 or len(points) % 2:
        return isinstance(corners, list) and not corners
    if len(points) < 6:
        return True
    from_first = points.reshape(-1, 2).astype(float) - points[:2]
    far = from_first[np.argmax(np.hypot(*from_first.T))]
    across = from_first[:, 0] * far[1] - from_first[:, 1] * far[0]
    return bool(np.all(np.abs(across) <= 1e-9 * (far @ far)))


def check_region_count(path: Path, key: str, count: int, size: tuple[int, int]) -> None:
    """Raise ``InputError`` for more regions of one kind in a frame than can be drawn in a few seconds."""
    most = max(1, MAX_DRAWN_PIXELS // (size[0] * size[1]))
    if count > most:
        raise InputError(path, key, f"{count} regions in one frame", f"at most {most} at {size[0]} x {size[1]}")


def union(regions: Iterable[Bool[ndarray, "H W"]], size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Return the pixels in any of some regions."""
    out = np.zeros(size[::-1], dtype=bool)
    for pixels in regions:
        out |= pixels
    return out


ALL_INSTANCES = "all"
ZERO_AREA_NOTE = "polygons without area were left out"


@dataclass(frozen=True, eq=False)
class Region:
    """A labelled region in a frame."""

    key: str
    """Position in the file."""
    labels: tuple[str, ...]
    """Labels that choose the region; the first one is its name."""
    thing: str
    """Number of the instance of the label, the same in all frames; empty if not stated."""
    content: object
    """Polygons, run lengths or a ``PngRegion``."""
    size: tuple[int, int] | None = None
    """Width and height of the region's image; None for the clip's size."""
    path: Path | None = None
    """The region's file; None if there is one file only."""

    @property
    def name(self) -> str:
        """Label and instance."""
        return f"{self.labels[0]}:{self.thing}" if self.thing else self.labels[0]

    def is_of(self, chosen: Sequence[str]) -> bool:
        """Return whether the region is among the chosen labels and instances."""
        return bool({*self.labels} & {*chosen}) or self.is_named_apart(chosen)

    def is_named_apart(self, chosen: Sequence[str]) -> bool:
        """Return whether the region's instance, or all instances of its label, are chosen."""
        return any({f"{label}:{self.thing}", f"{label}:{ALL_INSTANCES}"} & {*chosen} for label in self.labels)


def region_masks(path: Path, request: MaskRequest, regions: Mapping[int, Sequence[Region]]) -> MaskReader:
    """Open the regions of some frames. Raises ``InputError`` for several labels without a chosen one."""
    frames = {n: _FrameRegions.of(of_frame, request) for n, of_frame in regions.items()}
    labels = {one.labels[0] for frame in frames.values() for one in frame.object}
    if not request.object and len(labels) > 1:
        raise InputError(path, "categories", f"several, {_join_label_names(labels)}", "one, or --object names it")
    warnings = (
        *_describe_label_ambiguity("--object", request.object, [frame.object for frame in frames.values()]),
        *_describe_label_ambiguity("--hand", request.hand, [frame.hand for frame in frames.values()]),
    )
    notes = Counter[str]()

    def drawn(found: Sequence[Region]) -> Bool[ndarray, "H W"]:
        check_region_count(path, "annotations", len(found), request.size)
        return union(_pixels(found), request.size)

    def _pixels(found: Sequence[Region]) -> Iterator[Bool[ndarray, "H W"]]:
        for one in found:
            content = drop_flat_polygons(one.content)
            if isinstance(one.content, list) and isinstance(content, list) and len(content) < len(one.content):
                notes[ZERO_AREA_NOTE] += len(one.content) - len(content)
            size = request.check_size(one.path or path, one.key, run_length_size(content) or one.size or request.size)
            yield request.resized(decode_region(one.path or path, one.key, content, size, notes), notes)

    def read(n: int) -> FrameMasks:
        frame = frames[n]
        hand = drawn(frame.hand) if request.hand else None
        return combine_hand_object_masks(drawn(frame.object), drawn(frame.ignore), hand)

    chosen = {"--object": request.object, "--ignore": request.ignore, "--hand": request.hand}
    every = [one for of_frame in regions.values() for one in of_frame]
    named = [(option, word) for option, words in chosen.items() for word in words]
    unmet = {f"{option} {word}" for option, word in named if not any(one.is_of([word]) for one in every)}
    everything = {one.name for one in every}
    return MaskReader(path, read, frames.keys(), {*sorted(everything)[:MAX_NAMES_IN_ERROR]}, unmet, notes, warnings)


@dataclass(frozen=True)
class _FrameRegions:
    """The chosen regions of a frame, by kind."""

    object: Sequence[Region]
    ignore: Sequence[Region]
    hand: Sequence[Region]

    @staticmethod
    def of(regions: Sequence[Region], request: MaskRequest) -> _FrameRegions:
        kinds: dict[str, list[Region]] = {"object": [], "ignore": [], "hand": []}
        chosen = {"hand": request.hand, "ignore": request.ignore, "object": request.object}
        for one in regions:
            kind = next((kind for kind, words in chosen.items() if one.is_of(words)), "")
            if kind or not request.object:
                kinds[kind or "object"].append(one)
        return _FrameRegions(**kinds)


def _describe_label_ambiguity(option: str, chosen: Sequence[str], frames: Sequence[Sequence[Region]]) -> Iterator[str]:
    """Describe the labels that choose several instances, and how to choose one."""
    by_label: dict[str, list[list[Region]]] = {}
    for of_frame in frames:
        here: dict[str, list[Region]] = {}
        for one in of_frame:
            if not one.is_named_apart(chosen):
                here.setdefault(one.labels[0], []).append(one)
        for label, found in here.items():
            by_label.setdefault(label, []).append(found)
    for label, each in by_label.items():
        things = {one.thing for found in each for one in found}
        counts = [sum(not one.thing for one in found) + len({one.thing for one in found} - {""}) for found in each]
        if len(things) < 2 and max(counts) < 2:
            continue
        name, several = printable(label), sum(count > 1 for count in counts)
        where = f"{max(counts)} regions in {several} of {len(frames)} frames" if several else "one in each frame"
        names = sorted(f"{label}:{one}" for one in things - {""})[:MAX_NAMES_IN_ERROR]
        way = f"{option} chooses one: {' or '.join(map(printable, names))}" if names else "a track_id tells them apart"
        yield (
            f"several things are called {name}, {where}, and were taken together; {way}; "
            f"{option} {name}:{ALL_INSTANCES} if all are meant"
        )


def _join_label_names(names: set[str]) -> str:
    return ", ".join(map(printable, sorted(names)[:MAX_NAMES_IN_ERROR]))


THING_KEYS = ("track_id", "instance_id", "object_id")
"""Keys of the number of an instance of a category."""


def open_coco_masks(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open COCO's annotations; the object is not visible in images without any. Raises ``InputError``."""
    images, names = check_object_list(path, content, "images"), []
    for k, image in enumerate(images):
        if not isinstance(image.get("file_name"), str) or not isinstance(image.get("id"), int | str):
            raise InputError(path, f"images[{k}]", shorten_value(image), "an id and a file_name")
        extra = image.get("extra")
        original = extra.get("name") if isinstance(extra, dict) else None  # Roboflow's
        names.append(original if isinstance(original, str) else image["file_name"])
    if len({*names}) < len(names):  # versions of one image
        names = [image["file_name"] for image in images]
    places = request.places(path, names)
    stated = ("width", "height", request)
    sizes = {n: read_stated_size(path, f"images[{k}]", images[k], *stated) for n, k in places.items()}
    index = {images[k]["id"]: n for n, k in places.items()}
    regions: dict[int, list[Region]] = {n: [] for n in places}
    for key, item, labels in _iter_annotations(path, content, "image_id"):
        if item["image_id"] in index:
            n = index[item["image_id"]]
            pixels = item.get("segmentation")
            regions[n].append(Region(f"{key}.segmentation", labels, _instance_of(item), pixels, sizes[n]))
    return region_masks(path, request, regions)


def open_youtube_vis_masks(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open YouTube-VIS's annotations: a region of each instance for each frame of its video, or null."""
    names: list[str] = []
    where: list[tuple[object, int]] = []
    for k, video in enumerate(check_object_list(path, content, "videos")):
        of_video = video.get("file_names")
        if not isinstance(video.get("id"), int | str) or not isinstance(of_video, list):
            raise InputError(path, f"videos[{k}]", shorten_value(video), "an id and file_names")
        if not all(isinstance(name, str) for name in of_video):
            raise InputError(path, f"videos[{k}].file_names", shorten_value(of_video), "names of files")
        names += of_video
        where += [(video["id"], row) for row in range(len(of_video))]
    index = {where[k]: n for n, k in request.places(path, names).items()}
    regions: dict[int, list[Region]] = {n: [] for n in index.values()}
    for key, item, labels in _iter_annotations(path, content, "video_id"):
        listed = item.get("segmentations")
        if not isinstance(listed, list):
            raise InputError(path, f"{key}.segmentations", shorten_value(listed), "a region for each frame, or null")
        for row, one in enumerate(listed):
            n = index.get((item["video_id"], row))
            if n is not None and one is not None:
                regions[n].append(Region(f"{key}.segmentations[{row}]", labels, str(item.get("id", "")), one))
    return region_masks(path, request, regions)


def read_stated_size(
    path: Path, key: str, content: Mapping[str, object], width: str, height: str, request: MaskRequest
) -> tuple[int, int]:
    """Read the size of an image in a file. Raises ``InputError`` for another shape than the clip's."""
    sides = content.get(width), content.get(height)
    if not all(type(side) is int and side > 0 for side in sides):
        raise InputError(path, key, " x ".join(map(shorten_value, sides)), "{} x {}".format(*request.size))
    return request.check_size(path, key, sides)  # type: ignore[arg-type]


def check_object_list(path: Path, content: Mapping[str, object], key: str, needed: bool = True) -> list[files.Json]:
    """Check a list of JSON objects. Raises ``InputError``."""
    value = content.get(key, None if needed else [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        got = "no such key" if key not in content else shorten_value(value)
        raise InputError(path, key, got, "a list of objects, as COCO has it")
    return value


def _iter_annotations(
    path: Path, content: Mapping[str, object], of: str
) -> Iterator[tuple[str, files.Json, tuple[str, ...]]]:
    """Yield each annotation's position, content and labels: its category's name and id."""
    categories = check_object_list(path, content, "categories", needed=False)
    names = {str(item.get("id")): str(item.get("name")) for item in categories}
    for k, item in enumerate(check_object_list(path, content, "annotations")):
        category = item.get("category_id")
        if not isinstance(item.get(of), int | str) or not isinstance(category, int | str):
            article = "an" if of[0] in "aeiou" else "a"
            raise InputError(path, f"annotations[{k}]", shorten_value(item), f"{article} {of} and a category_id")
        label = str(category)
        yield f"annotations[{k}]", item, (names[label], label) if label in names else (label,)


def _instance_of(item: Mapping[str, object]) -> str:
    """Return the instance of an annotation; empty if not stated."""
    attributes = item.get("attributes")
    for value in (item, attributes if isinstance(attributes, dict) else {}):
        for key in THING_KEYS:
            if isinstance(value.get(key), int | str):
                return str(value[key])
    return ""


SHAPE_POINT_COUNTS = {"polygon": 0, "rotation": 0, "rectangle": 2, "circle": 2, "mask": 2}
"""Number of points of LabelMe's and X-AnyLabeling's shapes; 0 for any number."""
SUPPORTED_SHAPES = f"one of {', '.join(SHAPE_POINT_COUNTS)}; other shapes can be exported as COCO or PNG"


def open_labelme_masks(source: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open LabelMe's shapes; shapes with the same ``group_id`` are one instance. Raises ``InputError``."""
    regions: dict[int, list[Region]] = {}
    for n, k in request.places(source, [path.name for path in paths]).items():
        path = paths[k]
        content = files.read_json(path)
        size = read_stated_size(path, "imageWidth", content, "imageWidth", "imageHeight", request)
        shapes = check_object_list(path, content, "shapes")
        each = [_labelme_region(path, f"shapes[{i}]", item, size) for i, item in enumerate(shapes)]
        regions[n] = _group_polygons(each)
    return region_masks(source, request, regions)


def _group_polygons(found: Sequence[Region]) -> list[Region]:
    """Join the polygons of an instance, as an outline and its hole, which have the same ``group_id``."""
    groups: dict[tuple[object, ...], list[Region]] = {}
    for k, one in enumerate(found):
        alone = not one.thing or not isinstance(one.content, list)
        groups.setdefault((one.labels, one.thing, k if alone else -1), []).append(one)
    return [
        replace(of[0], content=[corners for one in of for corners in cast("list[object]", one.content)])
        if len(of) > 1
        else of[0]
        for of in groups.values()
    ]


def _labelme_region(path: Path, key: str, item: Mapping[str, object], size: tuple[int, int]) -> Region:
    label, group, kind = item.get("label"), item.get("group_id"), item.get("shape_type", "polygon")
    points = arrays.from_lists(item.get("points"))
    if not isinstance(label, str) or kind not in SHAPE_POINT_COUNTS:
        got = shorten_value(kind if isinstance(label, str) else label)
        raise InputError(path, key, got, f"a label, {SUPPORTED_SHAPES}")
    if points is None or points.dtype.kind not in "fi" or points.ndim != 2 or points.shape[1] != 2:
        raise InputError(path, f"{key}.points", shorten_value(item.get("points")), "[[x, y], ...]")
    if SHAPE_POINT_COUNTS[kind] not in (0, len(points)) or not np.isfinite(points).all():
        raise InputError(path, f"{key}.points", f"{len(points)} points", f"{SHAPE_POINT_COUNTS[kind]} points")
    content: object = [points.ravel().tolist()]
    if kind == "rectangle":
        (x0, y0), (x1, y1) = points.tolist()
        content = [[x0, y0, x1, y0, x1, y1, x0, y1]]
    elif kind == "circle":  # its middle, and a point of it
        radius, angles = float(np.hypot(*(points[1] - points[0]))), np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
        content = [(points[0] + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)).ravel().tolist()]
    elif kind == "mask":
        left, top = np.clip(points.min(axis=0), -1, max(size)).tolist()
        content = PngRegion(_decode_png(path, key, item.get("mask")), (round(left), round(top)))
    return Region(f"{key}.points", (label,), "" if group is None else str(group), content, size, path)


def _decode_png(path: Path, key: str, text: object) -> bytes:
    try:
        return base64.b64decode(text if isinstance(text, str) else "-", validate=True)
    except ValueError as error:
        raise InputError(path, f"{key}.mask", shorten_value(text), "a PNG in base64") from error


def open_masklets(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open SA-V's masklets: for each annotated frame of a video, the run lengths of each object, chosen by its number.

    Frames count from 0; every fourth one is annotated, by the number of the video's frames. Raises ``InputError``.
    """
    listed, count = content.get("masklet"), content.get("video_frame_count")
    if not isinstance(listed, list) or not all(isinstance(of_frame, list) for of_frame in listed) or not listed:
        raise InputError(path, "masklet", shorten_value(listed), "run lengths of each object in each frame")
    if not isinstance(count, int | float) or not len(listed) <= count <= 1e6:
        raise InputError(path, "video_frame_count", shorten_value(count), f"at least {len(listed)} frames")
    things = content.get("masklet_id")
    if not isinstance(things, list) or not all(len(of_frame) == len(things) for of_frame in listed):
        raise InputError(path, "masklet_id", shorten_value(things), "the number of each object in each frame")
    each = round(count / len(listed))
    places = request.places(path, [str(each * k) for k in range(len(listed))])
    regions = {
        n: [
            Region(f"masklet[{k}][{i}]", (str(thing),), "", content)
            for i, (thing, content) in enumerate(zip(things, listed[k], strict=True))
        ]
        for n, k in places.items()
    }
    return region_masks(path, request, regions)


def open_yolo_masks(source: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open YOLO's outlines, a text for each image: lines of a class's number, and corners as fractions of the sides.

    Raises ``InputError``.
    """
    regions: dict[int, list[Region]] = {}
    for n, k in request.places(source, [path.name for path in paths]).items():
        regions[n] = []
        for row, line in enumerate(files.read_text(paths[k]).splitlines(), start=1):
            words = line.split()
            try:
                corners = np.array(words[1:], dtype=float).reshape(-1, 2) * request.size
            except ValueError:
                corners = np.zeros((0, 2))
            if words and (len(corners) < 3 or not np.isfinite(corners).all()):
                expected = "a class and at least three corners, x y x y x y; boxes are no masks"
                raise InputError(paths[k], f"line {row}", shorten_value(line), expected)
            if words:
                regions[n].append(Region(f"line {row}", (words[0],), "", [corners.ravel().tolist()], path=paths[k]))
    return region_masks(source, request, regions)
