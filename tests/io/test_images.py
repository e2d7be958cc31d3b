"""Images: read at their expected size, whatever kind of PNG, and written whole."""

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
from getagrip.io.images import decode_image, read_colour_png, read_image, read_png, write_image
from getagrip.readers.masks.mask_request import read_label_image

PICTURE = np.tile(np.linspace(0, 255, 40).astype(np.uint8)[None, :, None], (30, 1, 3)) // np.array([1, 2, 3], np.uint8)


@pytest.mark.parametrize(("name", "tolerance"), [("a.png", 0), ("a.jpg", 12), ("a.JPG", 12)])
def test_images_come_back(tmp_path: Path, name: str, tolerance: int) -> None:
    Image.fromarray(PICTURE).save(tmp_path / name, quality=95)
    back = read_image(tmp_path / name, (40, 30))
    assert np.abs(back.astype(int) - PICTURE).max() <= tolerance


def test_images_on_their_side_are_turned_upright(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter to the right
    Image.fromarray(PICTURE).save(tmp_path / "a.jpg", exif=exif, quality=95)
    back = read_image(tmp_path / "a.jpg", (30, 40))
    assert np.abs(back.astype(int) - np.rot90(PICTURE, -1)).max() <= 12


def test_images_of_too_many_scans_are_refused_before_they_are_decoded(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    path, noise = tmp_path / "a.jpg", np.random.default_rng(0).bytes(30_000) + b"\xff\xda" * 1000
    Image.fromarray(PICTURE).save(path, progressive=True, comment=noise, icc_profile=noise)
    assert read_image(path, (40, 30)).shape == (30, 40, 3)  # other segments may hold any bytes
    whole = path.read_bytes()
    last = whole[whole.rindex(b"\xff\xda") : -2]
    path.write_bytes(whole[:-2] + last * 80 + whole[-2:])
    assert read_image(path, (40, 30)).shape == (30, 40, 3)
    for between in (b"", b"\xff\xff", b"\0\xff\0", b"\xff\xd0", b"\xff\xfe\0\0"):
        content = whole[:-2] + (between + last) * 100 + whole[-2:]
        path.write_bytes(content)
        refused(lambda: read_image(path, (40, 30)), "a.jpg: scans must be ", "got more than 100")
        refused(
            lambda content=content: decode_image(path, "the video", content, 100),
            "a.jpg: the video scans must be ",
            "got more",
        )


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_others_are_refused(tmp_path: Path, refused: Callable[..., str], suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_image(path, PICTURE)
    refused(lambda: read_image(path, (64, 64)), path.name, "40 x 30 pixels", "64 x 64")
    whole = path.read_bytes()
    for content in (b"", b"nonsense", whole[: len(whole) // 2]):
        path.write_bytes(content)
        refused(lambda: read_image(path, (40, 30)), path.name)


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
