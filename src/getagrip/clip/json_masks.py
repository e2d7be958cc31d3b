"""Masks in JSON: COCO's, YouTube-VIS's and SA-V's masklets, a file for all images; LabelMe's shapes, one for each."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from getagrip.clip.mask_request import MaskReader, MaskRequest
from getagrip.clip.region_masks import Region, region_masks
from getagrip.clip.segments import PngRegion
from getagrip.errors import InputError
from getagrip.io import arrays, files

THING_KEYS = ("track_id", "instance_id", "object_id")
"""By which trackers and annotators tell things of one category apart."""


def open_coco_masks(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open COCO's annotations; an image without any of the object shows nothing of it. Raises ``InputError``."""
    images, names = check_object_list(path, content, "images"), []
    for k, image in enumerate(images):
        if not isinstance(image.get("file_name"), str) or not isinstance(image.get("id"), int | str):
            raise InputError(path, f"images[{k}]", files.shorten_value(image), "an id and a file_name")
        extra = image.get("extra")
        original = extra.get("name") if isinstance(extra, dict) else None  # Roboflow's
        names.append(original if isinstance(original, str) else image["file_name"])
    if len({*names}) < len(names):  # versions of one image
        names = [image["file_name"] for image in images]
    places = request.places(path, names)
    sizes = {
        n: read_stated_size(path, f"images[{k}]", images[k], "width", "height", request) for n, k in places.items()
    }
    index = {images[k]["id"]: n for n, k in places.items()}
    regions: dict[int, list[Region]] = {n: [] for n in places}
    for key, item, labels in _iter_annotations(path, content, "image_id"):
        if item["image_id"] in index:
            n = index[item["image_id"]]
            regions[n].append(
                Region(f"{key}.segmentation", labels, _instance_of(item), item.get("segmentation"), sizes[n])
            )
    return region_masks(path, request, regions)


def open_youtube_vis_masks(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open YouTube-VIS's annotations: a region of each thing for each frame of its video, or null."""
    names: list[str] = []
    where: list[tuple[object, int]] = []
    for k, video in enumerate(check_object_list(path, content, "videos")):
        of_video = video.get("file_names")
        if not isinstance(video.get("id"), int | str) or not isinstance(of_video, list):
            raise InputError(path, f"videos[{k}]", files.shorten_value(video), "an id and file_names")
        if not all(isinstance(name, str) for name in of_video):
            raise InputError(path, f"videos[{k}].file_names", files.shorten_value(of_video), "names of files")
        names += of_video
        where += [(video["id"], row) for row in range(len(of_video))]
    index = {where[k]: n for n, k in request.places(path, names).items()}
    regions: dict[int, list[Region]] = {n: [] for n in index.values()}
    for key, item, labels in _iter_annotations(path, content, "video_id"):
        listed = item.get("segmentations")
        if not isinstance(listed, list):
            raise InputError(
                path, f"{key}.segmentations", files.shorten_value(listed), "a region for each frame, or null"
            )
        for row, one in enumerate(listed):
            n = index.get((item["video_id"], row))
            if n is not None and one is not None:
                regions[n].append(Region(f"{key}.segmentations[{row}]", labels, str(item.get("id", "")), one))
    return region_masks(path, request, regions)


def read_stated_size(
    path: Path, key: str, content: Mapping[str, object], width: str, height: str, request: MaskRequest
) -> tuple[int, int]:
    """Return the size that a file states of an image. Raises ``InputError`` for another shape than the clip's."""
    sides = content.get(width), content.get(height)
    if not all(type(side) is int and side > 0 for side in sides):
        raise InputError(path, key, " x ".join(map(files.shorten_value, sides)), "{} x {}".format(*request.size))
    return request.check_size(path, key, sides)  # type: ignore[arg-type]


def check_object_list(path: Path, content: Mapping[str, object], key: str, needed: bool = True) -> list[files.Json]:
    """Check a list of JSON objects. Raises ``InputError``."""
    value = content.get(key, None if needed else [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        got = "no such key" if key not in content else files.shorten_value(value)
        raise InputError(path, key, got, "a list of objects, as COCO has it")
    return value


def _iter_annotations(
    path: Path, content: Mapping[str, object], of: str
) -> Iterator[tuple[str, files.Json, tuple[str, ...]]]:
    """Each annotation with its place and its labels: its category's name and id."""
    categories = check_object_list(path, content, "categories", needed=False)
    names = {str(item.get("id")): str(item.get("name")) for item in categories}
    for k, item in enumerate(check_object_list(path, content, "annotations")):
        category = item.get("category_id")
        if not isinstance(item.get(of), int | str) or not isinstance(category, int | str):
            article = "an" if of[0] in "aeiou" else "a"
            raise InputError(path, f"annotations[{k}]", files.shorten_value(item), f"{article} {of} and a category_id")
        label = str(category)
        yield f"annotations[{k}]", item, (names[label], label) if label in names else (label,)


def _instance_of(item: Mapping[str, object]) -> str:
    """Which thing of its category an annotation is of; empty where it does not say."""
    attributes = item.get("attributes")
    for value in (item, attributes if isinstance(attributes, dict) else {}):
        for key in THING_KEYS:
            if isinstance(value.get(key), int | str):
                return str(value[key])
    return ""


SHAPE_POINT_COUNTS = {"polygon": 0, "rotation": 0, "rectangle": 2, "circle": 2, "mask": 2}
"""Points of LabelMe's and X-AnyLabeling's shapes; 0 for any number."""
SUPPORTED_SHAPES = f"one of {', '.join(SHAPE_POINT_COUNTS)}; as COCO or as PNG others can be read, too"


def open_labelme_masks(source: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open LabelMe's shapes, of one thing where they have one ``group_id``. Raises ``InputError``."""
    regions: dict[int, list[Region]] = {}
    for n, k in request.places(source, [path.name for path in paths]).items():
        path = paths[k]
        content = files.read_json(path)
        size = read_stated_size(path, "imageWidth", content, "imageWidth", "imageHeight", request)
        shapes = check_object_list(path, content, "shapes")
        regions[n] = _group_polygons(
            [_labelme_region(path, f"shapes[{i}]", item, size) for i, item in enumerate(shapes)]
        )
    return region_masks(source, request, regions)


def _group_polygons(found: Sequence[Region]) -> list[Region]:
    """Join the polygons of a thing, as an outline and its hole: they have one ``group_id``."""
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
        raise InputError(
            path, key, files.shorten_value(kind if isinstance(label, str) else label), f"a label, {SUPPORTED_SHAPES}"
        )
    if points is None or points.dtype.kind not in "fi" or points.ndim != 2 or points.shape[1] != 2:
        raise InputError(path, f"{key}.points", files.shorten_value(item.get("points")), "[[x, y], ...]")
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
    """Decode a mask's file. Raises ``InputError``."""
    try:
        return base64.b64decode(text if isinstance(text, str) else "-", validate=True)
    except ValueError as error:
        raise InputError(path, f"{key}.mask", files.shorten_value(text), "a PNG in base64") from error


def open_masklets(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open SA-V's masklets: for each annotated frame of a video the run lengths of each object, chosen by its number.

    Frames count from 0; every fourth is annotated, as the number of the video's frames says. Raises ``InputError``.
    """
    listed, count = content.get("masklet"), content.get("video_frame_count")
    if not isinstance(listed, list) or not all(isinstance(of_frame, list) for of_frame in listed) or not listed:
        raise InputError(path, "masklet", files.shorten_value(listed), "run lengths of each object in each frame")
    if not isinstance(count, int | float) or not len(listed) <= count <= 1e6:
        raise InputError(path, "video_frame_count", files.shorten_value(count), f"at least {len(listed)} frames")
    things = content.get("masklet_id")
    if not isinstance(things, list) or not all(len(of_frame) == len(things) for of_frame in listed):
        raise InputError(path, "masklet_id", files.shorten_value(things), "the number of each object in each frame")
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
    """Open YOLO's outlines, a text for each image: lines of a class's number and corners as shares of the sides.

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
                raise InputError(paths[k], f"line {row}", files.shorten_value(line), expected)
            if words:
                regions[n].append(Region(f"line {row}", (words[0],), "", [corners.ravel().tolist()], path=paths[k]))
    return region_masks(source, request, regions)
