"""Regions with labels: two images of one frame, several things of one label, polygons without area, other formats."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip.mask_request import MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.errors import UsageError
from helpers.mask_files import FRAMES, SIZE, encoded, write_png

REQUEST = MaskRequest(FRAMES, SIZE, ("cup",))
A, B = np.zeros((2, *SIZE[::-1]), dtype=bool)
A[2:6, 3:9], B[8:12, 11:18] = True, True


def image(n: int, name: str, **more: Any) -> dict[str, Any]:
    return {"id": n, "file_name": name, "width": SIZE[0], "height": SIZE[1], **more}


def write_coco(path: Path, images: list[dict[str, Any]], regions: list[dict[str, Any]]) -> Path:
    """A file with one category, cup; ``regions`` lack it."""
    annotations = [{"category_id": 1, **region} for region in regions]
    path.write_text(
        json.dumps({"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "cup"}]})
    )
    return path


def seen(source: Path, request: MaskRequest, n: int = 0) -> ndarray:
    read = open_masks(source, request)(n)
    assert read is not None
    return read.object


@pytest.mark.parametrize(
    ("first", "second", "choices"),
    [
        ("take1/{}.jpg", "take2/{}.jpg", ("take1", "take2")),
        ("train/rgb/{}.jpg", "val/rgb/{}.jpg", ("train/rgb", "val/rgb")),
        (r"take1\{}.jpg", r"take2\{}.jpg", ("take1", "take2")),
        ("{}.jpg", "more/{}.jpg", (".", "more")),
        ("{}.jpg", "{}.png", ("*.jpg", "*.png")),
        ("cam1_{}.jpg", "cam2_{}.jpg", ("cam1_*", "cam2_*")),
        ("all/cam1_{}.jpg", "all/cam2_{}.jpg", ("all/cam1_*", "all/cam2_*")),
    ],
)
def test_two_images_of_a_frame_are_chosen_from(
    tmp_path: Path, refused: Callable[..., str], first: str, second: str, choices: tuple[str, str]
) -> None:
    images = [image(k, name.format(FRAMES[k % 2])) for k, name in enumerate((first, first, second, second))]
    regions = [{"image_id": k, "segmentation": encoded(A if k < 2 else B, True)} for k in range(4)]
    path = write_coco(tmp_path / "c.json", images, regions)
    refused(
        lambda: open_masks(path, REQUEST),
        "second mask of frame 000003",
        f"--images chooses: {choices[0]} or {choices[1]}",
    )
    for choice, mask in zip(choices, (A, B), strict=True):
        np.testing.assert_array_equal(seen(path, replace(REQUEST, images=choice)), mask)
    with pytest.raises(UsageError, match=r"--mask-images must be .*got 'take3'"):
        open_masks(path, replace(REQUEST, images="take3", ask_images="--mask-images"))


def test_two_images_of_one_name_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = write_coco(tmp_path / "c.json", [image(k, f"{FRAMES[0]}.jpg") for k in range(2)], [])
    refused(lambda: open_masks(path, REQUEST), "second mask", "must be one")


def test_pngs_of_two_cameras_are_chosen_from(tmp_path: Path, refused: Callable[..., str]) -> None:
    for camera, mask in (("cam1", A), ("cam2", B)):
        write_png(tmp_path / f"{camera}_000003.png", 255 * mask, 8, 0)
    refused(lambda: open_masks(tmp_path, MaskRequest(FRAMES, SIZE)), "--images chooses: cam1_* or cam2_*")
    np.testing.assert_array_equal(seen(tmp_path, MaskRequest(FRAMES, SIZE, images="cam2_*")), B)


def test_the_original_name_is_roboflows(tmp_path: Path) -> None:
    images = [
        image(n, f"{name}_jpg.rf.{'0123456789abcdef' * 2}.jpg", extra={"name": f"{name}.jpg"})
        for n, name in enumerate(FRAMES)
    ]
    regions = [{"image_id": n, "segmentation": encoded((A, B)[n], True)} for n in range(2)]
    path = write_coco(tmp_path / "c.json", images, regions)
    for n, mask in enumerate((A, B)):
        np.testing.assert_array_equal(seen(path, REQUEST, n), mask)


@pytest.mark.parametrize("way", ["track_id", "instance_id", "attributes", ""])
def test_several_things_of_one_category_are_said(tmp_path: Path, way: str) -> None:
    def thing(k: int) -> dict[str, Any]:
        return {"attributes": {"track_id": k}} if way == "attributes" else {way: k} if way else {}

    regions = [
        {"image_id": n, "segmentation": encoded(mask, True), **thing(k)}
        for n in range(2)
        for k, mask in ((7, A), (8, B))
    ]
    path = write_coco(tmp_path / "c.json", [image(n, f"{name}.jpg") for n, name in enumerate(FRAMES)], regions)
    (warning,) = open_masks(path, REQUEST).warnings
    assert "2 regions in 2 of 2 frames" in warning
    np.testing.assert_array_equal(seen(path, REQUEST), A | B)
    assert open_masks(path, replace(REQUEST, object=("cup:all",))).warnings == ()
    assert "--hand" in open_masks(path, replace(REQUEST, object=("1:9",), hand=("cup",))).warnings[0]
    assert open_masks(path, replace(REQUEST, object=("1:9",), ignore=("cup",))).warnings == ()
    if way:
        assert "cup:7 or cup:8" in warning
        for k, mask in ((7, A), (8, B)):
            chosen = replace(REQUEST, object=(f"cup:{k}",))
            assert open_masks(path, chosen).warnings == ()
            np.testing.assert_array_equal(seen(path, chosen), mask)


def test_parts_of_one_thing_are_no_several(tmp_path: Path) -> None:
    parts = {"image_id": 0, "segmentation": [[3, 2, 9, 2, 9, 6, 3, 6], [11, 8, 18, 8, 18, 12, 11, 12]]}
    images = [image(0, f"{FRAMES[0]}.jpg")]
    assert open_masks(write_coco(tmp_path / "a.json", images, [parts]), REQUEST).warnings == ()
    tracked = [{"image_id": 0, "segmentation": encoded(mask, True), "track_id": 1} for mask in (A, B)]
    assert open_masks(write_coco(tmp_path / "b.json", images, tracked), REQUEST).warnings == ()


@pytest.mark.parametrize(
    "flat", [[4, 4], [4, 4, 5, 4], [4, 4, 4, 4, 4, 4], [1, 1, 5, 5, 9, 9, 2, 2], [4, 4, 9, 4, 4, 4, 9, 4], []]
)
def test_polygons_without_area_are_left_out(tmp_path: Path, flat: list[float]) -> None:
    square, bow = [3, 2, 9, 2, 9, 6, 3, 6], [3.0, 2.0, 9.0, 6.0, 9.0, 2.0, 3.0, 6.0]
    images = [image(n, f"{name}.jpg") for n, name in enumerate(FRAMES)]
    regions = [{"image_id": n, "segmentation": [shape, flat]} for n, shape in enumerate((square, bow))]
    reader = open_masks(write_coco(tmp_path / "c.json", images, regions), REQUEST)
    alone = open_masks(
        write_coco(tmp_path / "d.json", images, [{**r, "segmentation": r["segmentation"][:1]} for r in regions]),
        REQUEST,
    )
    for n in range(2):
        with_it, without = reader(n), alone(n)
        assert with_it is not None
        assert without is not None
        assert without.object.sum() > 8  # a bow tie has area
        np.testing.assert_array_equal(with_it.object, without.object)
    assert list(reader.notes.values()) == [2]


def test_youtube_vis_has_a_region_of_each_frame(tmp_path: Path) -> None:
    content = {
        "videos": [
            {"id": k, "file_names": [f"take{k}/{name}.jpg" for name in FRAMES], "width": SIZE[0], "height": SIZE[1]}
            for k in (1, 2)
        ],
        "annotations": [
            {"id": 5, "video_id": 1, "category_id": 1, "segmentations": [encoded(A, True), None]},
            {"id": 6, "video_id": 1, "category_id": 1, "segmentations": [None, encoded(B, False)]},
            {"id": 7, "video_id": 2, "category_id": 1, "segmentations": [encoded(B, True), encoded(A, True)]},
        ],
        "categories": [{"id": 1, "name": "cup"}],
    }
    (tmp_path / "y.json").write_text(json.dumps(content))
    request = replace(REQUEST, images="take1")
    assert "cup:5 or cup:6" in open_masks(tmp_path / "y.json", request).warnings[0]
    for thing, n, mask in (("cup:5", 0, A), ("cup:5", 1, A & B), ("cup:6", 1, B)):
        np.testing.assert_array_equal(seen(tmp_path / "y.json", replace(request, object=(thing,)), n), mask)
    np.testing.assert_array_equal(seen(tmp_path / "y.json", replace(request, images="take2"), 1), A)


def test_label_me_has_a_file_of_each_image(tmp_path: Path, refused: Callable[..., str]) -> None:
    def write(frame: str, shapes: list[dict[str, Any]]) -> None:
        content = {"shapes": shapes, "imageWidth": SIZE[0], "imageHeight": SIZE[1], "imagePath": f"{frame}.jpg"}
        (tmp_path / f"{frame}.json").write_text(json.dumps(content))

    corners = [[3.5, 2.5], [8.5, 2.5], [8.5, 5.5], [3.5, 5.5]]
    write("frame_3", [{"label": "cup", "points": corners, "shape_type": "polygon", "group_id": None}])
    write("frame_4", [{"label": "cup", "points": [corners[0], corners[2]], "shape_type": "rectangle"},
                      {"label": "hand", "points": corners, "shape_type": "polygon", "group_id": 2}])  # fmt: skip
    for n in range(2):
        np.testing.assert_array_equal(seen(tmp_path, REQUEST, n), A)
    read = open_masks(tmp_path, replace(REQUEST, hand=("hand:2",)))(1)
    assert read is not None
    assert read.hand is not None
    write("frame_4", [{"label": "cup", "points": [[1, 1], [2, 2]], "shape_type": "line"}])
    refused(lambda: open_masks(tmp_path, REQUEST), "frame_4.json", "'line'", "one of polygon, rotation, rectangle")


def test_masklets_are_of_every_fourth_frame(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "sav_manual.json"
    content: dict[str, Any] = {
        "masklet": [[encoded(A, True), encoded(B, True)], [encoded(B, True), encoded(A, True)]],
        "masklet_id": [0, 1],
        "video_frame_count": 7.0,
    }
    path.write_text(json.dumps(content))
    frames = tuple(f"{n:06d}" for n in range(7))
    reader = open_masks(path, MaskRequest(frames, SIZE, ("1",)))
    assert [n for n in range(7) if reader(n) is not None] == [0, 4]
    np.testing.assert_array_equal(seen(path, MaskRequest(frames, SIZE, ("1",)), 4), A)
    refused(lambda: open_masks(path, MaskRequest(frames, SIZE)), "several, 0, 1", "--object")
    path.write_text(json.dumps(content | {"masklet_id": [0]}))
    refused(lambda: open_masks(path, MaskRequest(frames, SIZE)), "masklet_id")
