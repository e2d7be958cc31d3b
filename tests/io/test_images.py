"""Images come back as they were written; those of another size, or damaged, are refused before they are decoded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from getagrip.io.images import decode_image, read_image, write_image

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
