"""Masks in arrays: ``.npz`` and ``.npy`` of all frames, or an array for each frame, SAM 2's pickles; soft edges.

Whole numbers and booleans are labels. Numbers with fractions from 0 to 1 are probabilities, with a threshold of one
half; with values below 0, they are logits, with a threshold of 0.

SAM 2's ``video_segments`` are ``{frame: {object: mask}}``, frames from 0, masks (1, H, W) or (H, W). SAM 3's outputs
are ``{frame: {"out_obj_ids": (N,), "out_binary_masks": (N, H, W)}}``.

Resizing, smoothing and lossy compression leave soft edges; the threshold is half of the maximum. An image of labels has
areas of each label; a soft mask has areas of the background and the maximum only, with steps between them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.clip import FrameMasks, frame_indices
from getagrip.clip.match_frames import MAX_NAMES_IN_ERROR, frame_of
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files, pickles
from getagrip.io.files import printable, shorten_value
from getagrip.readers.masks.mask_regions import union
from getagrip.readers.masks.mask_request import LabelChoice, MaskReader, MaskRequest, combine_hand_object_masks

SOFT_EDGES_NOTE = "edges are soft: values of half of the maximum and more were used, in images"
N_SAMPLED_IMAGES = 9
MIN_SOFT_MAXIMUM = 64
"""Minimum maximum of a soft mask; smaller values are labels."""
MIN_EDGE_VALUES, MULTI_MASK_EDGE_VALUES = 3, 8
"""Minimum number of edge values of a soft mask, and of several soft masks in one image."""
MIN_INTERIOR_FRACTION = 0.25
"""Minimum fraction of an area's pixels that equal all four neighbours."""


Load = Callable[[int], tuple[Path, Int[ndarray, "H W"]]]
"""A function that reads the labels of a frame, with their file."""


def binarise_soft_masks(
    load: Load, frames: Collection[int], notes: Counter[str], named: Sequence[int] = (), others: bool = False
) -> Load:
    """Load masks with soft edges as one label, if a sample of the images has soft edges.

    ``named`` are the object's labels that the user names; ``others`` is True for further named labels. ``notes`` counts
    the images with soft edges.
    """
    looked = (soft_maximum(*load(n), named, others) for n in sample_frames(frames))
    maximum = next((one for one in looked if one is not None), None)
    notes.clear()  # the sampled images are read again
    if maximum is None:
        return load

    def half(n: int) -> tuple[Path, Int[ndarray, "H W"]]:
        path, labels = load(n)
        notes[SOFT_EDGES_NOTE] += 1
        return path, np.where(2 * np.max(_colour_channels(labels), axis=0) >= maximum, named[0] if named else 255, 0)

    return half


def sample_frames(frames: Collection[int]) -> list[int]:
    """Sample frames evenly."""
    every = sorted(frames)
    return [every[i] for i in frame_indices(len(every), N_SAMPLED_IMAGES)]


def soft_maximum(path: Path, labels: Int[ndarray, "H W"], named: Sequence[int], others: bool) -> int | None:
    """Return the maximum of a mask with soft edges; None for an image of labels, and for a sharp mask.

    Raises ``InputError`` for several masks with soft edges in one image, and for a named label that is an edge value.
    """
    channels = [channel for channel in _colour_channels(labels) if channel.any()]
    if not channels or not all(np.array_equal(channel, channels[0]) for channel in channels):
        return None
    values = channels[0]
    maximum = int(values.max())
    if maximum < MIN_SOFT_MAXIMUM:
        return None
    inside = _interior_pixels(values)
    count, count_inside = np.bincount(values.ravel()), np.bincount(values[inside], minlength=maximum + 1)
    value = np.flatnonzero(count)
    area = count_inside[value] >= MIN_INTERIOR_FRACTION * count[value]
    steps = int(np.count_nonzero(~area[(value > 0) & (value < maximum)]))
    several = value[area & (4 * value > maximum) & (4 * value < 3 * maximum)]
    if several.size and steps >= MULTI_MASK_EDGE_VALUES:
        some = ", ".join(map(str, [*several[:6], maximum]))
        raise InputError(path, "labels", f"soft edges between several, {some}", "sharp ones, or a mask of each thing")
    if several.size or steps < MIN_EDGE_VALUES:
        return None
    edge = next((one for one in named if 2 * max(one >> 16, one >> 8 & 255, one & 255) < min(maximum, 255)), None)
    if edge is not None or others:
        got = "a mask with soft edges, the only thing in the image"
        raise InputError(path, "labels", got, "--object for its maximum or for nothing, no --ignore and --hand")
    return maximum


def area_values(labels: Int[ndarray, "H W"]) -> list[int]:
    """Return the values, except for the background, that have areas and not only edges."""
    values, at, count = np.unique(labels, return_inverse=True, return_counts=True)
    if len(values) < 3:
        return [value for value in values.tolist() if value]
    within = np.bincount(at.ravel()[_interior_pixels(labels).ravel()], minlength=len(values))
    return [int(value) for value in values[(within >= MIN_INTERIOR_FRACTION * count) & (within > 0)] if value]


def _interior_pixels(values: Int[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return which pixels equal all of their neighbours."""
    inside = np.ones(values.shape, dtype=bool)
    for axis in (0, 1):
        same = np.diff(values, axis=axis) == 0
        first, last = ((slice(None),) * axis + (cut,) for cut in (slice(1, None), slice(None, -1)))
        inside[first] &= same
        inside[last] &= same
    return inside


def _colour_channels(labels: Int[ndarray, "H W"]) -> list[Int[ndarray, "H W"]]:
    """Return red, green and blue of colours, else the values."""
    return [labels] if labels.max(initial=0) < 2**16 else [labels >> 16, labels >> 8 & 255, labels & 255]


MASK_KINDS = ("object", "ignore", "hand")
LOGITS_NOTE = "logits: values above 0 were used, in images"
PROBABILITIES_NOTE = "probabilities: values of one half and more were used, in images"
Numbers = Callable[[int], tuple[Path, str, ndarray]]
"""A function that reads a frame's array, with its file and key."""


def open_npz_masks(path: Path, request: MaskRequest) -> MaskReader:
    """Open masks or labels of all frames, or an array for each, in an ``.npz`` file. Raises ``InputError``."""
    stored = arrays.read(path, lambda _: True)
    key = next((key for key in ("labels", "object") if key in stored), None)
    if key is None:
        names = [name for name, array in stored.items() if array.ndim in (2, 3)]
        if not any(frame_of(name, request.frames) is not None for name in names):
            there = f"the arrays {', '.join(map(printable, list(stored)[:3]))}" if stored else "no array"
            raise InputError(path, "object", there, "the array, or one called labels, or one for each frame")
        rows = request.places(path, [f"{name}.npy" for name in names])
        return _label_reader(path, lambda n: (path, names[rows[n]], stored[names[rows[n]]]), rows, request)
    if stored[key].ndim == 4 and stored[key].shape[1] == 1:
        stored[key] = stored[key][:, 0]
    kinds = (key,) if key == "labels" else tuple(kind for kind in MASK_KINDS if kind in stored)
    width, height = request.size
    for name in kinds:
        expected = f"numbers or booleans of shape (n, H, W), as (n, {height}, {width})"
        if stored[name].ndim != 3 or stored[name].shape != stored[key].shape:
            raise InputError(path, name, f"{stored[name].dtype} of shape {stored[name].shape}", expected)
    rows = _match_stack_rows(path, stored, len(stored[key]), request)
    if key == "labels":
        return _label_reader(path, lambda n: (path, key, stored[key][rows[n]]), rows, request)
    notes = Counter[str]()
    loads = {kind: _binary_mask_loader(path, kind, stored[kind], rows, request, notes) for kind in kinds}

    def read(n: int) -> FrameMasks:
        at = {kind: request.resized(load(n)[1] != 0, notes) for kind, load in loads.items()}
        return combine_hand_object_masks(at["object"], at.get("ignore", np.zeros_like(at["object"])), at.get("hand"))

    return MaskReader(path, read, rows.keys(), notes=notes)


def open_npy_masks(path: Path, request: MaskRequest) -> MaskReader:
    """Open masks or labels of all frames in an ``.npy`` file, in their order. Raises ``InputError``."""
    stack = arrays.parse_npy(path, "", files.read_bytes(path, arrays.MAX_NPZ_BYTES))
    rows = _match_stack_rows(path, {}, len(stack) if stack.ndim else 0, request)
    return _label_reader(path, lambda n: (path, "", stack[rows[n]]), rows, request)


def open_npy_folder(folder: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    """Open a folder with an ``.npy`` file of each frame, or an ``.npz`` file of one array. Raises ``InputError``."""
    if len(paths) == 1 and is_stack(paths[0]):
        return (open_npz_masks if paths[0].suffix == ".npz" else open_npy_masks)(paths[0], request)
    rows = request.places(folder, [path.name for path in paths])

    def load(n: int) -> tuple[Path, str, ndarray]:
        path = paths[rows[n]]
        if path.suffix == ".npy":
            return path, "", arrays.parse_npy(path, "", files.read_bytes(path, arrays.MAX_NPZ_BYTES))
        stored = arrays.read(path, lambda _: True)
        if len(stored) != 1:
            raise InputError(path, "", f"{len(stored)} arrays", "one, the labels of a frame")
        return path, *next(iter(stored.items()))

    return _label_reader(folder, load, rows, request)


def is_stack(path: Path) -> bool:
    """Return whether the first array of a file is a stack of images. Raises ``InputError``."""
    if path.suffix == ".npy":
        array = arrays.parse_npy(path, "", files.read_bytes(path, arrays.MAX_NPZ_BYTES))
    else:
        array = next(iter(arrays.read(path, lambda _: True).values()), np.zeros(0))
    return array.ndim > 2 and array.size > array.shape[-1] * array.shape[-2]


def _label_reader(source: Path, load: Numbers, frames: Mapping[int, int], request: MaskRequest) -> MaskReader:
    choose, notes = LabelChoice(request), Counter[str]()
    whole = _label_loader(load, frames, request, notes)
    sharp = binarise_soft_masks(whole, frames, notes, choose.object, bool(choose.ignore or choose.hand))

    def read(n: int) -> FrameMasks:
        path, labels = sharp(n)
        return choose(path, request.resized(labels, notes))

    return MaskReader(source, read, frames.keys(), choose.others, choose.unmet, notes)


def _binary_mask_loader(
    path: Path, key: str, stack: ndarray, rows: Mapping[int, int], request: MaskRequest, notes: Counter[str]
) -> Load:
    return binarise_soft_masks(_label_loader(lambda n: (path, key, stack[rows[n]]), rows, request, notes), rows, notes)


def _label_loader(load: Numbers, frames: Collection[int], request: MaskRequest, notes: Counter[str]) -> Load:
    samples = (load(n)[2] for n in sample_frames(frames))
    logits = any(array.dtype.kind == "f" and array.size and array.min() < 0.0 for array in samples)

    def labels(n: int) -> tuple[Path, Int[ndarray, "H W"]]:
        path, key, array = load(n)
        array = _check_image_array(path, key, array, request)
        if array.dtype.kind != "f":
            return path, array.astype(np.int64)
        least, most = float(array.min()), float(array.max())  # NaN where any is
        whole = np.isfinite(least + most) and least >= 0.0 and bool(np.all(array == np.floor(array)))
        if not np.isfinite(least + most) or not (logits or whole or 0.0 <= least <= most <= 1.0):
            expected = "whole numbers, probabilities from 0 to 1, or logits"
            raise InputError(path, key, f"numbers from {least:g} to {most:g}", expected)
        if whole and not logits:
            return path, np.minimum(array, 2.0**24).astype(np.int64)
        notes[LOGITS_NOTE if logits else PROBABILITIES_NOTE] += 1
        return path, (array > 0.0 if logits else array >= 0.5).astype(np.int64)

    return labels


def _match_stack_rows(path: Path, stored: Mapping[str, ndarray], count: int, request: MaskRequest) -> dict[int, int]:
    if "frames" not in stored:
        return request.in_order(path, count)
    names = arrays.array_from_names(stored["frames"])
    if names is None or len(names) != count:
        raise InputError(path, "frames", shorten_value(stored["frames"]), f"{count} names, or numbers from 0 on")
    return request.places(path, [str(name) for name in names])


MAX_SEGMENTS_BYTES = 512 * 2**20
"""Maximum size of a file: 250 masks of 1920 x 1080."""
SEGMENTS_DESCRIPTION = "SAM 2's video_segments, {frame: {object: mask}}, or SAM 3's outputs of each frame"
SAM3_KEYS = (("out_obj_ids", "out_binary_masks"), ("object_ids", "masks"))
"""Keys of a frame's objects and their masks, of SAM 3's predictor and of transformers."""


def open_video_segments(path: Path, request: MaskRequest) -> MaskReader:
    """Open the masks of numbered objects; an object without a mask in a frame is not visible.

    Raises ``InputError`` for malformed frames and without any requested frame, ``UsageError`` for unknown labels.
    """
    value = pickles.read_pickle_file(path, SEGMENTS_DESCRIPTION, MAX_SEGMENTS_BYTES)
    below = next((name for name in value if isinstance(name, int) and name < 0), None)
    if below is not None:
        raise InputError(path, "", f"a frame {below}", f"{SEGMENTS_DESCRIPTION}, frames from 0 on")
    names, masks = list(value), dict[int, dict[str, ndarray]]()
    for n, row in request.places(path, names).items():
        name = names[row]
        of_frame = _masks_by_object(path, name, value[name])
        masks[n] = {str(key): _check_mask_array(path, f"{name}.{key}", mask, request) for key, mask in of_frame.items()}
    there = sorted({key for of_frame in masks.values() for key in of_frame})
    chosen = request.object or tuple(there[:1])
    unknown = next((name for name in (*chosen, *request.ignore, *request.hand) if name not in there), None)
    if unknown is not None or (len(there) > 1 and not request.object) or not chosen:
        option = "--ignore" if unknown in request.ignore else "--hand" if unknown in request.hand else "--object"
        which = f"missing {option}" if unknown is None else f"unknown {option} {unknown!r}"
        raise UsageError(f"{which}; choose from the objects of {path}: {_list_names(there)}")

    notes = Counter[str]()

    def read(n: int) -> FrameMasks:
        visible, hidden, hand = (
            union([request.resized(masks[n][name], notes) for name in names if name in masks[n]], request.size)
            for names in (chosen, request.ignore, request.hand)
        )
        return combine_hand_object_masks(visible, hidden, hand if request.hand else None)

    return MaskReader(path, read, masks.keys(), notes=notes)


def _masks_by_object(path: Path, name: str, of_frame: object) -> Mapping[object, object]:
    """Return the masks of a frame by object, from SAM 2 or SAM 3. Raises ``InputError``."""
    if not isinstance(of_frame, Mapping):
        raise InputError(path, printable(name), shorten_value(of_frame), SEGMENTS_DESCRIPTION)
    found = next(((ids, masks) for ids, masks in SAM3_KEYS if ids in of_frame and masks in of_frame), None)
    if found is None:
        return of_frame
    ids, masks = (of_frame[key] for key in found)
    try:
        return {str(int(one)): mask for one, mask in zip(ids, masks, strict=True)}
    except (TypeError, ValueError) as error:
        key = f"{printable(name)}.{found[0]}"
        raise InputError(path, key, shorten_value(ids), "a number for each mask") from error


def _check_mask_array(path: Path, key: str, value: object, request: MaskRequest) -> Bool[ndarray, "H W"]:
    expected = "a mask of booleans, whole numbers or logits"
    if not isinstance(value, ndarray):
        raise InputError(path, printable(key), shorten_value(value), expected)
    value = _check_image_array(path, printable(key), value, request)
    if value.dtype.kind == "f":
        least, most = float(value.min()), float(value.max())  # NaN where any is
        if not (least < 0.0 or 0.0 <= least <= most <= 1.0) or np.isnan(most):
            raise InputError(path, printable(key), f"numbers from {least:g} to {most:g}", expected)
        return np.asarray(value >= (0.5 if least >= 0.0 else np.nextafter(0.0, 1.0)))
    return np.asarray(value != 0)


def _check_image_array(path: Path, key: str, array: ndarray, request: MaskRequest) -> ndarray:
    """Return an image (h, w) of numbers, of any size. Raises ``InputError``."""
    if array.dtype.kind not in "biuf" or array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[0] != 1):
        expected = f"numbers or booleans of shape ({request.size[1]}, {request.size[0]})"
        raise InputError(path, key, f"{array.dtype} of shape {array.shape}", expected)
    height, width = list(array.shape)[-2:]
    request.check_size(path, key, (width, height))
    return array.reshape(height, width)


def holds_objects(path: Path) -> bool:
    """Return whether an ``.npy`` file holds Python objects, or is damaged, rather than numbers."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        with path.open("rb") as stream:
            return bool(headers[np.lib.format.read_magic(stream)](stream)[2].hasobject)
    except Exception:  # the header is a Python literal: its parser raises many things
        return True


def _list_names(names: object) -> str:
    all_names = [printable(str(name)) for name in names] if isinstance(names, list | dict) else []
    return ", ".join(all_names[:MAX_NAMES_IN_ERROR]) + (", ..." if len(all_names) > MAX_NAMES_IN_ERROR else "")
