"""Masks from a clip's folder: those of the frames that are asked for, and no more of them in memory at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import Clip, Masks
from getagrip.errors import InputError
from getagrip.io import files


def read_masks(clip: Clip) -> Masks:
    """Read and check the masks of a clip's frames.

    Raises ``InputError`` for a missing or unsuitable image, and where no frame shows the object. The folder
    ``masks/ignore`` may be absent; where it is there, it has an image for each frame.
    """
    width, height = clip.size
    masks = Masks(*np.zeros((2, len(clip), height, width), dtype=bool))
    for n, (seen, ignore) in enumerate(_each(clip)):
        masks.object[n], masks.ignore[n] = seen, ignore
    _check_some(clip, bool(masks.object.any()))
    return masks


def read_seen(clip: Clip) -> Bool[ndarray, "T"]:
    """Frames in which something of the object is seen: ``read_masks(clip).seen``, one frame at a time in memory."""
    any_object, seen = False, np.zeros(len(clip), dtype=bool)
    for n, (mask, ignore) in enumerate(_each(clip)):
        any_object |= bool(mask.any())
        seen[n] = (mask & ~ignore).any()
    _check_some(clip, any_object)
    return seen


def _each(clip: Clip) -> Iterator[tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"]]]:
    """Object mask and ignored pixels of each frame."""
    width, height = clip.size
    hidden = (clip.folder / "masks" / "ignore").exists()
    for frame in clip.frames:
        seen = _read(clip, "object", frame)
        yield seen, _read(clip, "ignore", frame) if hidden else np.zeros((height, width), dtype=bool)


def _read(clip: Clip, kind: str, frame: str) -> Bool[ndarray, "H W"]:
    """The mask of a frame."""
    path = files.inside(clip.folder, f"masks/{kind}/{frame}.png", "", "a mask for each frame of clip.json")
    return files.read_png(path, clip.size) != 0


def _check_some(clip: Clip, any_object: bool) -> None:
    """Refuse masks that are all empty."""
    if not any_object:
        folder = clip.folder / "masks" / "object"
        raise InputError(folder, "", f"{len(clip)} masks without a pixel", "masks that show the object")
