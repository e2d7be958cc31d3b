"""Masks with soft edges, and those in the alpha channel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.readers.masks.mask_request import MaskRequest, read_label_image
from getagrip.readers.masks.mask_sources import open_masks

SIZE = (160, 120)
FRAMES = ("000001", "000002", "000003")
REQUEST = MaskRequest(FRAMES, SIZE)


def shapes() -> ndarray:
    """A disc in two frames, nothing in the third."""
    out = np.zeros((3, *SIZE[::-1]), np.uint8)
    for n in range(2):
        cv2.circle(out[n], (60 + 9 * n, 55), 33, 255, -1)
    return out


def jpeg(mask: ndarray) -> ndarray:
    _, content = cv2.imencode(".jpg", mask, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE))


def resized(mask: ndarray) -> ndarray:
    small = cv2.resize(mask, (80, 60), interpolation=cv2.INTER_AREA)
    return cv2.resize(small, SIZE, interpolation=cv2.INTER_LANCZOS4)


def red(mask: ndarray) -> ndarray:
    return np.stack([0 * mask, 0 * mask, cv2.GaussianBlur(mask, (5, 5), 0)], axis=-1)


SOFT: dict[str, Callable[[ndarray], ndarray]] = {
    "blurred": lambda mask: cv2.GaussianBlur(mask, (9, 9), 0),
    "blurred a little": lambda mask: cv2.GaussianBlur(mask, (3, 3), 0),
    "resized": resized,
    "JPEG": jpeg,
    "16 bit": lambda mask: cv2.GaussianBlur(mask, (9, 9), 0).astype(np.uint16) * 257,
    "grey as colours": lambda mask: cv2.cvtColor(cv2.GaussianBlur(mask, (5, 5), 0), cv2.COLOR_GRAY2BGR),
    "red": red,
    "probabilities": lambda mask: cv2.GaussianBlur(mask, (31, 31), 0),
}


def written(folder: Path, images: list[ndarray]) -> Path:
    folder.mkdir(parents=True)
    for name, image in zip(FRAMES, images, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    return folder


def iou(folder: Path, request: MaskRequest) -> float:
    """The smallest overlap with the shapes; 1 where both are nothing."""
    reader, each = open_masks(folder, request), []
    for n, shape in enumerate(shapes() > 0):
        read = reader(n)
        assert read is not None
        either = (read.object | shape).sum()
        each.append((read.object & shape).sum() / either if either else 1.0)
    return float(min(each))


@pytest.mark.parametrize("way", SOFT)
def test_half_and_more_is_the_object(tmp_path: Path, way: str) -> None:
    folder = written(tmp_path / "m", [SOFT[way](mask) for mask in shapes()])
    reader = open_masks(folder, REQUEST)
    assert iou(folder, REQUEST) > 0.97
    reader(0)
    assert list(reader.notes.values()) == [1]
    if way in ("blurred", "resized", "JPEG", "grey as colours"):
        assert iou(folder, MaskRequest(FRAMES, SIZE, ("255",))) > 0.97
    thing = written(tmp_path / "things" / "cup", [SOFT[way](mask) for mask in shapes()])
    assert iou(thing.parent, MaskRequest(FRAMES, SIZE, ("cup",))) > 0.97


def test_labels_are_no_soft_edges(tmp_path: Path, refused: Callable[..., str]) -> None:
    """Also large ones, and of a ring of one pixel, as of VOS benchmarks."""
    images = [np.where(np.roll(mask, 30, axis=1) > 0, 100, mask).astype(np.uint8) for mask in shapes()]
    for image in images:
        image[20:90, 140:150] = 200
    folder = written(tmp_path / "m", images)
    refused(lambda: open_masks(folder, REQUEST)(0), "several, 100, 200, 255")
    reader = open_masks(folder, MaskRequest(FRAMES, SIZE, ("255",), ("100",), ("200",)))
    read = reader(0)
    assert read is not None
    np.testing.assert_array_equal(read.object, images[0] == 255)
    assert not reader.notes


def test_soft_edges_of_several_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    both = [cv2.GaussianBlur(np.maximum(mask, np.roll(mask, 70, axis=1) // 2), (9, 9), 0) for mask in shapes()]
    folder = written(tmp_path / "m", both)
    refused(lambda: open_masks(folder, MaskRequest(FRAMES, SIZE, ("255",))), "soft edges between several")
    alone = written(tmp_path / "n", [SOFT["blurred"](mask) for mask in shapes()])
    refused(lambda: open_masks(alone, MaskRequest(FRAMES, SIZE, ("16",))), "soft edges", "--object")


def photograph() -> ndarray:
    return np.random.default_rng(0).integers(0, 256, (*SIZE[::-1], 3)).astype(np.uint8)


@pytest.mark.parametrize("colour", ["white", "black", "photograph"])
@pytest.mark.parametrize("soft", [False, True])
def test_alpha_is_the_mask_where_it_varies(tmp_path: Path, colour: str, soft: bool) -> None:
    blank = np.zeros((*SIZE[::-1], 3), np.uint8)
    picture = {"white": blank + np.uint8(255), "black": blank, "photograph": photograph()}[colour]
    alphas = [SOFT["blurred"](mask) if soft else mask for mask in shapes()]
    folder = written(tmp_path / "m", [np.dstack([picture, alpha]) for alpha in alphas])
    assert iou(folder, REQUEST) > 0.97
    reader = open_masks(folder, REQUEST)
    reader(0)
    assert list(reader.notes.values()) == [1]


def test_colours_count_where_they_say_otherwise(tmp_path: Path) -> None:
    """Labels before a transparent background, and where alpha is the same everywhere."""
    mask, other = shapes()[0] > 0, np.zeros(SIZE[::-1], bool)
    other[100:115, 100:150] = True
    labels = np.zeros((*SIZE[::-1], 4), np.uint8)
    labels[mask], labels[other] = (0, 0, 255, 255), (0, 255, 0, 255)
    cv2.imwrite(str(tmp_path / "a.png"), labels)
    np.testing.assert_array_equal(read_label_image(tmp_path / "a.png", SIZE), 0xFF0000 * mask + 0x00FF00 * other)
    for alpha in (255, 0):
        labels[..., 3] = alpha
        cv2.imwrite(str(tmp_path / "a.png"), labels)
        np.testing.assert_array_equal(read_label_image(tmp_path / "a.png", SIZE), 0xFF0000 * mask + 0x00FF00 * other)
