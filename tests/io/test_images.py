"""Images: read at their expected size, whatever kind of PNG, and written whole."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from getagrip.errors import InputError
from getagrip.io.images import decode_image, read_colour_png, read_image, read_mask, write_image, write_mask
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


def one_bit(rows: bytes, interlaced: bool) -> bytes:
    """Make a PNG of a bit per pixel, of ``SIZE``, with right checksums."""
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", *SIZE, 1, 0, 0, 0, interlaced)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    )
    parts = [struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


MASK = one_bit(np.pad(np.packbits(GREY > 99, axis=1), [(0, 0), (1, 0)]).tobytes(), interlaced=False)


def test_pixels_are_those_that_were_written(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), GREY)
    cv2.imwrite(str(tmp_path / "rgb.png"), RGB[..., ::-1])
    cv2.imwrite(str(tmp_path / "rgba.png"), np.dstack([RGB[..., ::-1], GREY]))
    np.testing.assert_array_equal(read_mask(tmp_path / "grey.png", SIZE).unpacked, GREY > 0)
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


@given(
    size=st.tuples(st.integers(1, 40), st.integers(1, 12)),
    fill=st.sampled_from([0.0, 0.1, 0.9, 1.0]),
    seed=st.integers(),
)
def test_a_mask_comes_back_from_every_kind_of_grey_png(
    tmp_path_factory: pytest.TempPathFactory, size: tuple[int, int], fill: float, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("png")
    mask = np.random.default_rng(abs(seed)).random(size[::-1]) < fill
    write_mask(folder / "ours.png", mask)
    Image.fromarray(mask).save(folder / "filtered.png")
    Image.fromarray(mask.astype(np.uint8)).save(folder / "bytes.png")
    np.testing.assert_array_equal(np.asarray(Image.open(folder / "ours.png")), mask)
    for path in folder.iterdir():
        np.testing.assert_array_equal(read_mask(path, size).unpacked, mask)


def test_pixels_beyond_a_masks_width_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(one_bit(b"\0\x80\xff" * 9, interlaced=False))
    mask = read_mask(tmp_path / "a.png", SIZE)
    assert mask.box == (0, 0, 13, 9)
    assert mask.unpacked.sum(axis=1).tolist() == [6] * 9


def test_a_filtered_or_interlaced_mask_of_one_bit_is_decoded(tmp_path: Path) -> None:
    up = b"\0\x80\x08" + b"\2\0\0" * 8  # every row is the one above
    (tmp_path / "a.png").write_bytes(one_bit(up, interlaced=False))
    assert np.argwhere(read_mask(tmp_path / "a.png", SIZE).unpacked.all(axis=0)).ravel().tolist() == [0, 12]
    passes = (2, 2), (2, 2), (4, 1), (3, 3), (7, 2), (6, 5), (13, 4)  # Adam7's images of 13 x 9 [px]
    rows = [height * (b"\0" + b"\xff" * -(-width // 8)) for width, height in passes]
    (tmp_path / "b.png").write_bytes(one_bit(b"".join(rows), interlaced=True))
    assert read_mask(tmp_path / "b.png", SIZE).is_full


@pytest.mark.parametrize("rows", [b"\0\0\0" * 8, b"\0\0\0" * 10, b"\0\0\0" * 8 + b"\0"], ids=["short", "long", "cut"])
def test_a_mask_of_another_number_of_pixels_is_refused(tmp_path: Path, refused: Refused, rows: bytes) -> None:
    (tmp_path / "a.png").write_bytes(one_bit(rows, interlaced=False))
    refused(lambda: read_mask(tmp_path / "a.png", SIZE), "whole PNG file")


@given(content=st.sampled_from([WHOLE, MASK]), at=st.integers(0, 10**6), bit=st.integers(0, 7))
def test_one_bit_wrong_is_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes, at: int, bit: int) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    damaged = bytearray(content)
    damaged[at % len(content)] ^= 1 << bit
    path.write_bytes(damaged)
    with pytest.raises(InputError):
        read_mask(path, SIZE)


@given(whole=st.sampled_from([WHOLE, MASK]), length=st.integers(0, 10**6), after=st.binary(min_size=1, max_size=40))
def test_a_file_cut_short_or_longer_is_refused(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, length: int, after: bytes
) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    for content in (whole[: length % len(whole)], whole + after):
        path.write_bytes(content)
        with pytest.raises(InputError, match="must be a whole PNG file"):
            read_mask(path, SIZE)


def test_more_than_8_bits_are_labels_in_grey_images_only(tmp_path: Path, refused: Refused) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), 257 * GREY.astype(np.uint16))
    cv2.imwrite(str(tmp_path / "rgb.png"), 257 * RGB.astype(np.uint16))
    np.testing.assert_array_equal(read_label_image(tmp_path / "grey.png", SIZE), 257 * GREY.astype(int))
    refused(lambda: read_mask(tmp_path / "grey.png", SIZE), "channels", "16 bit grey")
    for read in (read_label_image, read_colour_png):
        refused(lambda read=read: read(tmp_path / "rgb.png", SIZE), "channels", "16 bit RGB")  # type: ignore[misc]


def test_other_images_are_no_png(tmp_path: Path, refused: Refused) -> None:
    for suffix in (".jpg", ".bmp"):
        (tmp_path / "a.png").write_bytes(cv2.imencode(suffix, GREY)[1].tobytes())
        refused(lambda: read_mask(tmp_path / "a.png", SIZE), "no PNG")
