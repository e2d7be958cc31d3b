"""PNG images: pixels as another library wrote them, and nothing of a file that is not whole."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from getagrip.errors import InputError
from getagrip.io.images import read_colour_png, read_png
from getagrip.readers.masks.mask_request import read_label_image

Refused = Callable[..., str]
SIZE = (13, 9)
GREY = np.random.default_rng(0).integers(0, 256, SIZE[::-1], dtype=np.uint8)
RGB = np.random.default_rng(1).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
WHOLE = cv2.imencode(".png", GREY)[1].tobytes()


def test_pixels_are_those_that_were_written(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), GREY)
    cv2.imwrite(str(tmp_path / "rgb.png"), RGB[..., ::-1])
    cv2.imwrite(str(tmp_path / "rgba.png"), np.dstack([RGB[..., ::-1], GREY]))
    np.testing.assert_array_equal(read_png(tmp_path / "grey.png", SIZE), GREY)
    np.testing.assert_array_equal(read_colour_png(tmp_path / "grey.png", SIZE), np.dstack([GREY] * 3))
    for name in ("rgb.png", "rgba.png"):
        np.testing.assert_array_equal(read_colour_png(tmp_path / name, SIZE), RGB)


def test_a_palette_gives_its_colours_also_where_it_is_transparent(tmp_path: Path) -> None:
    image = Image.fromarray(RGB).quantize(7)
    image.save(tmp_path / "p.png", transparency=bytes([0, 100, 255]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(read_colour_png(tmp_path / "p.png", SIZE), np.asarray(image.convert("RGB")))
        np.testing.assert_array_equal(read_label_image(tmp_path / "p.png", SIZE), np.asarray(image))


@given(at=st.integers(0, len(WHOLE) - 1), bit=st.integers(0, 7))
def test_one_bit_wrong_is_refused(tmp_path_factory: pytest.TempPathFactory, at: int, bit: int) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    damaged = bytearray(WHOLE)
    damaged[at] ^= 1 << bit
    path.write_bytes(damaged)
    with pytest.raises(InputError):
        read_png(path, SIZE)


@given(length=st.integers(0, len(WHOLE) - 1), after=st.binary(min_size=1, max_size=40))
def test_a_file_cut_short_or_longer_is_refused(
    tmp_path_factory: pytest.TempPathFactory, length: int, after: bytes
) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    for content in (WHOLE[:length], WHOLE + after):
        path.write_bytes(content)
        with pytest.raises(InputError, match="must be a whole PNG file"):
            read_png(path, SIZE)


def test_more_than_8_bits_are_labels_in_grey_images_only(tmp_path: Path, refused: Refused) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), 257 * GREY.astype(np.uint16))
    cv2.imwrite(str(tmp_path / "rgb.png"), 257 * RGB.astype(np.uint16))
    np.testing.assert_array_equal(read_label_image(tmp_path / "grey.png", SIZE), 257 * GREY.astype(int))
    refused(lambda: read_png(tmp_path / "grey.png", SIZE), "channels", "16 bit grey")
    for read in (read_label_image, read_colour_png):
        refused(lambda read=read: read(tmp_path / "rgb.png", SIZE), "channels", "16 bit RGB")  # type: ignore[misc]


def test_other_images_are_no_png(tmp_path: Path, refused: Refused) -> None:
    for suffix in (".jpg", ".bmp"):
        (tmp_path / "a.png").write_bytes(cv2.imencode(suffix, GREY)[1].tobytes())
        refused(lambda: read_png(tmp_path / "a.png", SIZE), "no PNG")
