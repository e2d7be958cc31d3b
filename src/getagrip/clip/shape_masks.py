"""Masks in JSON of shapes and run lengths: LabelMe's, a file for each image; SA-V's masklets, one for a video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from getagrip.clip.coco_masks import check_size, objects
from getagrip.clip.mask_request import MaskReader, MaskRequest
from getagrip.clip.region_masks import Region, region_masks
from getagrip.errors import InputError
from getagrip.io import arrays, files

SHAPES = "polygons and rectangles; as COCO or as PNG others can be read, too"


def label_me(source: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open LabelMe's shapes, of one thing where they have one ``group_id``. Raises ``InputError``."""
    regions: dict[int, list[Region]] = {}
    for n, k in request.places(source, [path.name for path in paths]).items():
        path = paths[k]
        content = files.read_json(path)
        check_size(path, "imageWidth", content.get("imageWidth"), content.get("imageHeight"), request)
        regions[n] = [_shape(path, f"shapes[{i}]", item) for i, item in enumerate(objects(path, content, "shapes"))]
    return region_masks(source, request, regions)


def _shape(path: Path, key: str, item: Mapping[str, object]) -> Region:
    label, group, kind = item.get("label"), item.get("group_id"), item.get("shape_type", "polygon")
    points = arrays.from_lists(item.get("points"))
    if not isinstance(label, str) or kind not in ("polygon", "rectangle"):
        raise InputError(path, key, files.shown(kind if isinstance(label, str) else label), f"a label, {SHAPES}")
    if points is None or points.dtype.kind not in "fi" or points.ndim != 2 or points.shape[1] != 2:
        raise InputError(path, f"{key}.points", files.shown(item.get("points")), "[[x, y], ...]")
    corners = points.ravel().tolist()
    if kind == "rectangle":
        if len(points) != 2:
            raise InputError(path, f"{key}.points", f"{len(points)} points", "two opposite corners")
        (x0, y0), (x1, y1) = points.tolist()
        corners = [x0, y0, x1, y0, x1, y1, x0, y1]
    return Region(f"{key}.points", (label,), "" if group is None else str(group), [corners], path)


def masklets(path: Path, content: Mapping[str, object], request: MaskRequest) -> MaskReader:
    """Open SA-V's masklets: for each annotated frame of a video the run lengths of each object, chosen by its number.

    Frames count from 0; every fourth is annotated, as the number of the video's frames says. Raises ``InputError``.
    """
    listed, count = content.get("masklet"), content.get("video_frame_count")
    if not isinstance(listed, list) or not all(isinstance(of_frame, list) for of_frame in listed) or not listed:
        raise InputError(path, "masklet", files.shown(listed), "run lengths of each object in each frame")
    if not isinstance(count, int | float) or not len(listed) <= count <= 1e6:
        raise InputError(path, "video_frame_count", files.shown(count), f"at least {len(listed)} frames")
    things = content.get("masklet_id")
    if not isinstance(things, list) or not all(len(of_frame) == len(things) for of_frame in listed):
        raise InputError(path, "masklet_id", files.shown(things), "the number of each object in each frame")
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
