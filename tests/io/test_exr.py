"""EXR files: what was written is read, and no damage is more than an error."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip.depth import read_channel
from getagrip.errors import InputError
from helpers.program_files import exr

MOST = 10_000


@pytest.mark.parametrize("compression", [0, 2, 3])
@pytest.mark.parametrize("dtype", ["<f2", "<f4"])
@pytest.mark.parametrize("names", [("Y",), ("B", "G", "R"), ("A", "Z")])
def test_numbers_are_read_as_they_were_written(
    tmp_path: Path, compression: int, dtype: str, names: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(0)
    channels = {name: rng.uniform(0.3, 3.0, (37, 11)).astype(dtype) for name in names}
    (tmp_path / "depth.exr").write_bytes(exr(channels, compression))
    wanted = next(name for name in ("Z", "Y", "R") if name in channels)
    np.testing.assert_array_equal(read_channel(tmp_path / "depth.exr", MOST), channels[wanted])


def test_damage_is_an_error_or_other_numbers(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    whole = exr({"Y": rng.uniform(0.3, 3.0, (20, 7)).astype("<f4")})
    path = tmp_path / "depth.exr"
    for k in range(300):
        damaged = bytearray(whole[: rng.integers(len(whole))] if k % 3 == 0 else whole)
        for at in rng.integers(0, max(len(damaged), 1), 3) if damaged else ():
            damaged[at] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        with suppress(InputError):
            read_channel(path, MOST)


def test_other_kinds_are_refused(tmp_path: Path) -> None:
    path, image = tmp_path / "depth.exr", np.ones((200, 100), "<f4")
    path.write_bytes(exr({"Y": image}))
    with pytest.raises(InputError, match="pixels"):
        read_channel(path, MOST)
    path.write_bytes(exr({"Y": image}).replace(b"compression\0\x01\0\0\0\x03", b"compression\0\x01\0\0\0\x04"))
    with pytest.raises(InputError, match="none, ZIPS or ZIP"):
        read_channel(path, 10 * MOST)
