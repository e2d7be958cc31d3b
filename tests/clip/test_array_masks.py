"""Masks in numpy's files: of each frame or of all, labels, logits and probabilities."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.io import arrays
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from helpers.program_files import FRAMES, SIZE, labels

CUP = labels() == 1
REQUEST = MaskRequest(FRAMES, SIZE)


class Bomb:
    def __reduce__(self) -> Any:
        return (pytest.fail, ("a pickle was run",))


def written(path: Path, masks: ndarray, way: str) -> Path:
    """The masks of both frames in one of the ways."""
    if way == "npy of each":
        path.mkdir()
        for name, mask in zip(FRAMES, masks, strict=True):
            np.save(path / f"mask_{name}.npy", mask)
    elif way == "npz of each":
        path.mkdir()
        for name, mask in zip(FRAMES, masks, strict=True):
            np.savez(path / f"mask_{name}.npz", mask=mask[None])
    elif way == "npy":
        path = path.with_suffix(".npy")
        np.save(path, masks)
    else:
        path = path.with_suffix(".npz")
        keys = {"object": masks[:, None], "frames": np.array([3, 4])}
        arrays.write(path, keys if way == "npz" else {f"frame_{n + 3}": masks[n] for n in range(2)})
    return path


@pytest.mark.parametrize("way", ["npy of each", "npz of each", "npy", "npz", "npz of keys"])
@pytest.mark.parametrize("kind", ["bool", "uint16", "float", "logits", "probabilities"])
def test_every_way_gives_the_same_masks(tmp_path: Path, way: str, kind: str) -> None:
    masks = {
        "bool": CUP,
        "uint16": CUP.astype(np.uint16),
        "float": CUP.astype(np.float32),
        "logits": np.where(CUP, 0.01, -7.5).astype(np.float32),
        "probabilities": np.where(CUP, 0.5, 0.49).astype(np.float32),
    }[kind]
    reader = open_masks(written(tmp_path / "m", masks, way), REQUEST)
    for n in range(2):
        read = reader(n)
        assert read is not None
        np.testing.assert_array_equal(read.object, CUP[n])
    assert list(reader.notes.values()) == ([2] if kind in ("logits", "probabilities") else [])


@pytest.mark.parametrize("bad", [np.nan, np.inf, 2.5])
@pytest.mark.parametrize("way", ["npy of each", "npy", "npz"])
def test_numbers_that_are_no_masks_are_refused(
    tmp_path: Path, refused: Callable[..., str], bad: float, way: str
) -> None:
    masks = 0.75 * CUP
    masks[1, 0, 0] = bad
    path = written(tmp_path / "m", masks, way)
    refused(lambda: open_masks(path, REQUEST)(1), "numbers from", "logits")


def test_labels_are_chosen_in_arrays_of_each_frame(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = written(tmp_path / "m", labels().astype(np.uint16), "npy of each")
    refused(lambda: open_masks(path, REQUEST)(0), "labels", "--object")
    read = open_masks(path, MaskRequest(FRAMES, SIZE, ("1",), ("2",), ("3",)))(0)
    assert read is not None
    np.testing.assert_array_equal(read.object, CUP[0])
    np.testing.assert_array_equal(read.ignore, labels()[0] >= 2)


def test_no_pickle_is_run_and_shapes_are_checked(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = written(tmp_path / "m", CUP, "npy of each")
    bomb = np.array(Bomb(), dtype=object)
    np.save(path / f"mask_{FRAMES[1]}.npy", bomb)
    refused(lambda: open_masks(path, REQUEST)(1), "objects")
    np.save(path / f"mask_{FRAMES[1]}.npy", CUP[1, :, :-1])
    refused(lambda: open_masks(path, REQUEST)(1), f"mask_{FRAMES[1]}.npy", "20 x 14", "19 x 14")
    (tmp_path / "b.npy").write_bytes(pickle.dumps(bomb))
    refused(lambda: open_masks(tmp_path / "b.npy", REQUEST), "b.npy")
    np.savez(tmp_path / "b.npz", **{FRAMES[0]: bomb})
    refused(lambda: open_masks(tmp_path / "b.npz", REQUEST), "objects")
    np.savez(tmp_path / "c.npz", faces=np.zeros((3, 3)))
    refused(lambda: open_masks(tmp_path / "c.npz", REQUEST), "faces", "one for each frame")
