"""Masks and labels in numpy's files: ``.npz`` and ``.npy`` of all frames, or an array for each frame; SAM 2's pickles.

Whole numbers and booleans are labels. Of numbers with fractions, those from 0 to 1 are probabilities, of which half and
more counts; where some are below 0, they are logits, of which those above 0 count.

SAM 2's ``video_segments`` are ``{frame: {object: mask}}``, frames from 0, masks (1, H, W) or (H, W).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.label_choice import LabelChoice
from getagrip.clip.mask_request import MOST_NAMED, MaskReader, MaskRequest, without_object
from getagrip.clip.naming import frame_of
from getagrip.clip.segments import union
from getagrip.clip.soft_edges import Load, looked_at, sharpened
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files, pickles

KINDS = ("object", "ignore", "hand")
LOGITS, HALVES = (
    "logits: values above 0 were used, in images",
    "probabilities: values of one half and more were used, in images",
)
Numbers = Callable[[int], tuple[Path, str, ndarray]]
"""The file of a frame's array, its key, and the array."""


def npz(path: Path, request: MaskRequest) -> MaskReader:
    """Open masks or labels of all frames, or an array for each, in an ``.npz`` file. Raises ``InputError``."""
    stored = arrays.read(path, lambda _: True)
    key = next((key for key in ("labels", "object") if key in stored), None)
    if key is None:
        names = [name for name, array in stored.items() if array.ndim in (2, 3)]
        if not any(frame_of(name, request.frames) is not None for name in names):
            there = f"the arrays {', '.join(map(files.plain, list(stored)[:3]))}" if stored else "no array"
            raise InputError(path, "object", there, "the array, or one called labels, or one for each frame")
        rows = request.places(path, [f"{name}.npy" for name in names])
        return _labels(path, lambda n: (path, names[rows[n]], stored[names[rows[n]]]), rows, request)
    if stored[key].ndim == 4 and stored[key].shape[1] == 1:
        stored[key] = stored[key][:, 0]
    kinds = (key,) if key == "labels" else tuple(kind for kind in KINDS if kind in stored)
    width, height = request.size
    for name in kinds:
        expected = f"numbers or booleans of shape (n, H, W), as (n, {height}, {width})"
        if stored[name].shape != (*stored[key].shape[:1], height, width):
            raise InputError(path, name, f"{stored[name].dtype} of shape {stored[name].shape}", expected)
    rows = _rows(path, stored, len(stored[key]), request)
    if key == "labels":
        return _labels(path, lambda n: (path, key, stored[key][rows[n]]), rows, request)
    notes = Counter[str]()
    loads = {kind: _masks_of(path, kind, stored[kind], rows, request, notes) for kind in kinds}

    def read(n: int) -> FrameMasks:
        at = {kind: load(n)[1] != 0 for kind, load in loads.items()}
        return without_object(at["object"], at.get("ignore", np.zeros_like(at["object"])), at.get("hand"))

    return MaskReader(path, read, rows.keys(), notes=notes)


def npy(path: Path, request: MaskRequest) -> MaskReader:
    """Open masks or labels of all frames in an ``.npy`` file, in their order. Raises ``InputError``."""
    stack = arrays.parse_npy(path, "", files.read_bytes(path, arrays.LARGEST))
    rows = _rows(path, {}, len(stack) if stack.ndim else 0, request)
    return _labels(path, lambda n: (path, "", stack[rows[n]]), rows, request)


def npy_folder(folder: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open a folder with an ``.npy`` file of each frame, or an ``.npz`` file of one array. Raises ``InputError``."""
    rows = request.places(folder, [path.name for path in paths])

    def load(n: int) -> tuple[Path, str, ndarray]:
        path = paths[rows[n]]
        if path.suffix == ".npy":
            return path, "", arrays.parse_npy(path, "", files.read_bytes(path, arrays.LARGEST))
        stored = arrays.read(path, lambda _: True)
        if len(stored) != 1:
            raise InputError(path, "", f"{len(stored)} arrays", "one, the labels of a frame")
        return path, *next(iter(stored.items()))

    return _labels(folder, load, rows, request)


def _labels(source: Path, load: Numbers, frames: Mapping[int, int], request: MaskRequest) -> MaskReader:
    choose, notes = LabelChoice(request), Counter[str]()
    whole = _whole(load, frames, request.size, notes)
    sharp = sharpened(whole, frames, notes, choose.object, bool(choose.ignore or choose.hand))
    return MaskReader(source, lambda n: choose(*sharp(n)), frames.keys(), choose.others, notes)


def _masks_of(
    path: Path, key: str, stack: ndarray, rows: Mapping[int, int], request: MaskRequest, notes: Counter[str]
) -> Load:
    return sharpened(_whole(lambda n: (path, key, stack[rows[n]]), rows, request.size, notes), rows, notes)


def _whole(load: Numbers, frames: Collection[int], size: tuple[int, int], notes: Counter[str]) -> Load:
    """Make a loader of labels from arrays of any numbers."""
    samples = (load(n)[2] for n in looked_at(frames))
    logits = any(array.dtype.kind == "f" and array.size and array.min() < 0.0 for array in samples)

    def labels(n: int) -> tuple[Path, Int[ndarray, "H W"]]:
        path, key, array = load(n)
        width, height = size
        if array.dtype.kind not in "biuf" or array.shape not in {(height, width), (1, height, width)}:
            expected = f"numbers or booleans of shape ({height}, {width})"
            raise InputError(path, key, f"{array.dtype} of shape {array.shape}", expected)
        array = array.reshape(height, width)
        if array.dtype.kind != "f":
            return path, array.astype(np.int64)
        least, most = float(array.min()), float(array.max())  # NaN where any is
        whole = np.isfinite(least + most) and least >= 0.0 and bool(np.all(array == np.floor(array)))
        if not np.isfinite(least + most) or not (logits or whole or 0.0 <= least <= most <= 1.0):
            expected = "whole numbers, probabilities from 0 to 1, or logits"
            raise InputError(path, key, f"numbers from {least:g} to {most:g}", expected)
        if whole and not logits:
            return path, np.minimum(array, 2.0**24).astype(np.int64)
        notes[LOGITS if logits else HALVES] += 1
        return path, (array > 0.0 if logits else array >= 0.5).astype(np.int64)

    return labels


def _rows(path: Path, stored: Mapping[str, ndarray], count: int, request: MaskRequest) -> dict[int, int]:
    frames = request.frames
    if "frames" not in stored:
        if count != len(frames):
            raise InputError(path, "frames", f"no such array, {count} masks", f"{len(frames)} masks, or their frames")
        return {n: n for n in range(count)}
    names = arrays.names(stored["frames"])
    if names is None or len(names) != count:
        raise InputError(path, "frames", files.shown(stored["frames"]), f"{count} names, or numbers from 0 on")
    return request.places(path, [str(name) for name in names])


LARGEST = 512 * 2**20
"""Bytes of a file: 250 masks of 1920 x 1080."""
WHAT = "SAM 2's video_segments, {frame: {object: mask}}"


def video_segments(path: Path, request: MaskRequest) -> MaskReader:
    """Open a reader of the masks of numbered objects; in a frame without one, nothing of it is visible.

    Raises ``InputError`` for malformed frames and where there is none of the wanted ones, ``UsageError`` for labels.
    """
    value = pickles.read_file(path, WHAT, LARGEST)
    request.check_numbers(path, value)
    below = next((name for name in value if isinstance(name, int) and name < 0), None)
    if below is not None:
        raise InputError(path, "", f"a frame {below}", f"{WHAT}, frames from 0 on")
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
