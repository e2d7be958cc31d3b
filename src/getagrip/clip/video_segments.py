"""SAM 2's ``video_segments``, pickled: ``{frame: {object: mask}}``, frames from 0, masks (1, H, W) or (H, W).

Masks may be logits: what is above 0 counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.mask_request import MOST_NAMED, MaskReader, MaskRequest, without_object
from getagrip.clip.naming import frame_of
from getagrip.clip.segments import union
from getagrip.errors import InputError, UsageError
from getagrip.io import files, pickles

LARGEST = 512 * 2**20
"""Bytes of a file: 250 masks of 1920 x 1080."""
WHAT = "SAM 2's video_segments, {frame: {object: mask}}"


def video_segments(path: Path, request: MaskRequest) -> MaskReader:
    """Open a reader of the masks of numbered objects; in a frame without one, nothing of it is visible.

    Raises ``InputError`` for malformed frames and where there is none of the wanted ones, ``UsageError`` for labels.
    """
    value = pickles.read_file(path, WHAT, LARGEST)
    request.check_numbers(path, value)
    masks: dict[int, dict[str, ndarray]] = {}
    for name, of_frame in value.items():
        n = frame_of(name, request.frames)
        if n is not None:
            if not isinstance(of_frame, Mapping):
                raise InputError(path, files.plain(name), files.shown(of_frame), WHAT)
            masks[n] = {str(key): _mask(path, f"{name}.{key}", mask, request) for key, mask in of_frame.items()}
    if not masks:
        raise request.nothing(path, list(value))
    there = sorted({key for of_frame in masks.values() for key in of_frame})
    chosen = request.object or tuple(there[:1])
    unknown = next((name for name in (*chosen, *request.ignore, *request.hand) if name not in there), None)
    if unknown is not None or (len(there) > 1 and not request.object) or not chosen:
        option = "--ignore" if unknown in request.ignore else "--hand" if unknown in request.hand else "--object"
        which = f"missing {option}" if unknown is None else f"unknown {option} {unknown!r}"
        raise UsageError(f"{which}; choose from the objects of {path}: {_some(there)}")

    def read(n: int) -> FrameMasks:
        visible, hidden, hand = (
            union([masks[n][name] for name in names if name in masks[n]], request.size)
            for names in (chosen, request.ignore, request.hand)
        )
        return without_object(visible, hidden, hand if request.hand else None)

    return MaskReader(path, read, masks.keys())


def _mask(path: Path, key: str, value: object, request: MaskRequest) -> Bool[ndarray, "H W"]:
    """One mask. Raises ``InputError``."""
    width, height = request.size
    expected = f"a mask of booleans, whole numbers or logits, ({height}, {width}) or (1, {height}, {width})"
    if not isinstance(value, ndarray) or value.dtype.kind not in "biuf" or value.size != width * height:
        got = f"{value.dtype} of shape {value.shape}" if isinstance(value, ndarray) else files.shown(value)
        raise InputError(path, files.plain(key), got, expected)
    if value.shape not in {(height, width), (1, height, width)}:
        raise InputError(path, files.plain(key), f"the shape {value.shape}", expected)
    if value.dtype.kind == "f":
        least, most = float(value.min()), float(value.max())  # NaN where any is
        if not (least < 0.0 or 0.0 <= least <= most <= 1.0) or np.isnan(most):
            raise InputError(path, files.plain(key), f"numbers from {least:g} to {most:g}", expected)
        return np.asarray(value.reshape(height, width) >= (0.5 if least >= 0.0 else np.nextafter(0.0, 1.0)))
    return np.asarray(value.reshape(height, width) != 0)


def holds_objects(path: Path) -> bool:
    """Return whether an ``.npy`` file holds Python's objects, or is damaged; else it is an array of numbers."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        with path.open("rb") as stream:
            return bool(headers[np.lib.format.read_magic(stream)](stream)[2].hasobject)
    except Exception:  # the header is a Python literal: its parser raises many things
        return True


def _some(names: object) -> str:
    """List the first names, in words."""
    all_names = [files.plain(str(name)) for name in names] if isinstance(names, list | dict) else []
    return ", ".join(all_names[:MOST_NAMED]) + (", ..." if len(all_names) > MOST_NAMED else "")
