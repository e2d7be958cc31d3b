"""Regions with labels: two images of one frame, several things of one label, polygons without area, other formats."""

from __future__ import annotations

import base64
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from helpers.program_files import FRAMES, SIZE, encoded, write_png

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


@pytest.mark.parametrize("turned", [False, True])
def test_a_polygon_in_another_is_a_hole_if_it_is_wound_the_other_way(tmp_path: Path, turned: bool) -> None:
    outer, inner = [2, 2, 18, 2, 18, 12, 2, 12], [6, 5, 6, 9, 12, 9, 12, 5]
    inner = [
        each for corner in list(zip(inner[::2], inner[1::2], strict=True))[:: -1 if turned else 1] for each in corner
    ]
    images = [image(0, f"{FRAMES[0]}.jpg")]
    path = write_coco(tmp_path / "c.json", images, [{"image_id": 0, "segmentation": [inner, outer]}])
    reader = open_masks(path, REQUEST)
    read = reader(0)
    assert read is not None
    assert read.object[7, 9] == turned
    assert read.object[4, 4]
    assert any("inside others" in note for note in reader.notes) == turned


def test_label_me_s_pictures_circles_and_groups(tmp_path: Path) -> None:
    content = cv2.imencode(".png", A[2:6, 3:9] * np.uint8(255))[1].tobytes()
    picture = {"shape_type": "mask", "points": [[3, 2], [8, 5]], "mask": base64.b64encode(content).decode()}
    hole = [{"points": [[2, 2], [18, 2], [18, 12], [2, 12]]}, {"points": [[6, 5], [6, 9], [12, 9], [12, 5]]}]
    for shapes, inside, outside in (
        ([picture], (2, 3), (6, 3)),
        ([{"shape_type": "circle", "points": [[10, 7], [14, 7]]}], (7, 12), (7, 15)),
        ([{**one, "group_id": 1} for one in hole], (4, 4), (7, 9)),
    ):
        about = {"imageWidth": SIZE[0], "imageHeight": SIZE[1]}
        labelled = [{"label": "cup", "shape_type": "polygon", **one} for one in shapes]
        (tmp_path / f"{FRAMES[0]}.json").write_text(json.dumps({"shapes": labelled, **about}))
        read = seen(tmp_path, REQUEST)
        assert read[inside]
        assert not read[outside]


def test_masks_of_half_size_are_resized_and_said(tmp_path: Path, refused: Callable[..., str]) -> None:
    """In every kind of file; of another shape only where they are said to be stretched."""
    half = A[::2, ::2]
    images = [{**image(0, f"{FRAMES[0]}.jpg"), "width": 10, "height": 7}]
    sources = [write_coco(tmp_path / "c.json", images, [{"image_id": 0, "segmentation": encoded(half, True)}])]
    (tmp_path / "png").mkdir()
    write_png(tmp_path / "png" / f"{FRAMES[0]}.png", 1 * half, 8, 0)
    np.savez(tmp_path / "a.npz", object=half[None], frames=np.array(FRAMES[:1]))
    (tmp_path / "s.pkl").write_bytes(pickle.dumps({3: {"cup": half}}))
    for source in (*sources, tmp_path / "png", tmp_path / "a.npz", tmp_path / "s.pkl"):
        chosen = ("1",) if source.name == "png" else ("cup",)
        reader = open_masks(source, replace(REQUEST, object=chosen))
        read = reader(0)
        assert read is not None
        np.testing.assert_array_equal(read.object, np.kron(half, np.ones((2, 2), bool)))
        assert [*reader.notes] == ["masks of 10 x 7 pixels were resized to 20 x 14, in images"]
    write_png(tmp_path / "png" / f"{FRAMES[0]}.png", 1 * half[:, :7], 8, 0)
    square = replace(REQUEST, object=("1",))
    refused(lambda: open_masks(tmp_path / "png", square)(0), "7 x 7 pixels", "--stretched")
    assert seen(tmp_path / "png", replace(square, stretched=True)).shape == A.shape


def test_sam_3_s_outputs_yolo_s_texts_and_cvat_s_labels(tmp_path: Path, refused: Callable[..., str]) -> None:
    outputs = {n: {"out_obj_ids": np.array([4, 7]), "out_binary_masks": np.stack([A, B])} for n in (3, 4)}
    (tmp_path / "s.pkl").write_bytes(pickle.dumps(outputs))
    np.testing.assert_array_equal(seen(tmp_path / "s.pkl", replace(REQUEST, object=("7",))), B)
    (tmp_path / "yolo").mkdir()
    (tmp_path / "yolo" / f"{FRAMES[0]}.txt").write_text("1 0.15 0.15 0.45 0.15 0.45 0.43 0.15 0.43\n0 .9 .9 1 1 1 .9\n")
    read = seen(tmp_path / "yolo", replace(REQUEST, object=("1",)))
    assert read[3, 5]
    assert not read[12:].any()
    (tmp_path / "yolo" / f"{FRAMES[0]}.txt").write_text("1 0.5 0.5 0.2 0.2\n")
    refused(lambda: open_masks(tmp_path / "yolo", REQUEST), "boxes are no masks")
    for kind in ("SegmentationClass", "SegmentationObject"):
        (tmp_path / "cvat" / kind).mkdir(parents=True)
        picture = np.zeros((*A.shape, 3), np.uint8)
        picture[A], picture[B] = (83, 50, 250), (245, 61, 61)
        cv2.imwrite(str(tmp_path / "cvat" / kind / f"{FRAMES[0]}.png"), picture)
    things = replace(REQUEST, object=("SegmentationObject",))
    refused(lambda: open_masks(tmp_path / "cvat", things)(0), "several values, #3d3df5, #fa3253")
    (tmp_path / "cvat" / "labelmap.txt").write_text(
        "# label:color\nbackground:0,0,0::\nhand:61,61,245::\ncup:250,50,83::\n"
    )
    np.testing.assert_array_equal(seen(tmp_path / "cvat", REQUEST), A)
    with pytest.raises(UsageError, match=r"missing --object; choose from the labels of .*: hand, cup"):
        open_masks(tmp_path / "cvat", replace(REQUEST, object=()))


def test_labels_that_are_in_no_frame_are_said(tmp_path: Path) -> None:
    path = write_coco(
        tmp_path / "c.json", [image(0, f"{FRAMES[0]}.jpg")], [{"image_id": 0, "segmentation": encoded(A, True)}]
    )
    assert open_masks(path, replace(REQUEST, hand=("glove",))).unmet == {"--hand glove"}
    (tmp_path / "png").mkdir()
    write_png(tmp_path / "png" / f"{FRAMES[0]}.png", 1 * A, 8, 0)
    reader = open_masks(tmp_path / "png", replace(REQUEST, object=("1",), ignore=("5",)))
    reader(0)
    assert reader.unmet == {"--ignore 5"}
