"""Masks from a clip's folder: those of the frames that are asked for, and no more of them in memory at once."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import Clip, FrameMasks, Masks
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.images import read_png


def read_masks(clip: Clip) -> Masks:
    """Read and check the masks of a clip's frames.

    The mask of a frame without a file in ``masks/object`` is not known (``Masks.known``). Raises ``InputError`` for an
    unsuitable image, and where no frame shows the object. The folders ``masks/ignore`` and ``masks/hand`` may be
    absent; where they are there, they have an image for each frame that ``masks/object`` has.
    """
    folder = _folder(clip)
    masks = Masks.packed(_each(clip, with_hand=(folder / "masks" / "hand").exists()), clip.size)
    _check_some(clip, bool(masks.object.any()))
    return masks


def find_masks(clip: Clip) -> Masks | None:
    """The masks of a clip, as ``read_masks`` reads them; None where there is no folder of them."""
    return None if clip.folder is None or not (clip.folder / "masks" / "object").exists() else read_masks(clip)


def masks_of_some(clip: Clip, with_hand: bool = False) -> Masks | None:
    """``find_masks`` of some frames of a clip, none of which need show the object; those of the hand if wanted."""
    if clip.folder is None or not (clip.folder / "masks" / "object").exists():
        return None
    return Masks.packed(_each(clip, with_hand and (clip.folder / "masks" / "hand").exists()), clip.size)


def read_observed(clip: Clip) -> Bool[ndarray, "T"]:
    """``read_masks(clip).observed``, with one frame at a time in memory."""
    any_object, observed = False, np.zeros(len(clip), dtype=bool)
    for n, (mask, ignore, _) in enumerate(_each(clip)):
        any_object |= bool(mask.any())
        observed[n] = (mask & ~ignore).any()
    _check_some(clip, any_object)
    return observed


def _each(clip: Clip, with_hand: bool = False) -> Iterator[FrameMasks]:
    """The masks of each frame."""
    folder, (width, height) = _folder(clip), clip.size
    hidden = (folder / "masks" / "ignore").exists()
    for frame in clip.frames:
        if not has_mask(folder, frame):
            yield FrameMasks.unknown(clip.size, with_hand)
            continue
        mask = _read(folder, "object", frame, clip.size)
        ignore = _read(folder, "ignore", frame, clip.size) if hidden else np.zeros((height, width), dtype=bool)
        yield FrameMasks(mask, ignore, _read(folder, "hand", frame, clip.size) if with_hand else None)


def has_mask(folder: Path, frame: str) -> bool:
    """Whether there is a file, or a link, of the object's mask in a frame of the clip in a folder."""
    return os.path.lexists(folder / "masks" / "object" / f"{frame}.png")


def _folder(clip: Clip) -> Path:
    """The clip's folder. Raises ``InputError`` where it has none."""
    if clip.folder is None:
        raise InputError(clip.origin, "masks", "none, for a clip that is in no folder", "the masks beside the clip")
    return clip.folder


def _read(folder: Path, kind: str, frame: str, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """The mask of a frame."""
    path = files.inside(folder, f"masks/{kind}/{frame}.png", "", "a mask for each frame of clip.json")
    return read_png(path, size) != 0


def _check_some(clip: Clip, any_object: bool) -> None:
    """Refuse masks that are all empty."""
    if not any_object:
        folder = clip.origin / "masks" / "object"
        count = sum(has_mask(clip.origin, frame) for frame in clip.frames)
        got = f"{count} masks without a pixel" if count else "no mask of any frame"
        raise InputError(folder, "", got, "masks that show the object")
