"""Depth images in files: 16-bit PNG, ``.npy``, ``.npz`` of one array, EXR; ``depth/`` of a clip's folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import plausible
from getagrip.clip.data import Clip
from getagrip.clip.depth import DEPTH_KEY, N_WINDOW_SAMPLES, Depth, DepthSource, sample_window, sampling_windows
from getagrip.clip.masks import masks_in_memory, read_object_masks
from getagrip.errors import InputError
from getagrip.io import arrays, files
from getagrip.io.exr import read_channel
from getagrip.io.files import Json, shorten_value
from getagrip.io.images import open_png, png_size

DEPTH_SUFFIXES = (".png", ".npy", ".npz", ".exr")
MAX_DEPTH_PIXELS = 40_000_000
"""Pixels of an image."""
MAX_METRIC_DEPTH_M = 20.0
"""Distance beyond which metric depth of hand and object is in another unit [m]."""
MIN_DEPTH_UNIT_M, MAX_DEPTH_UNIT_M = 1e-12, 1e6
"""Bounds of the length that 1 stands for [m]."""
SATURATED_DEPTH = 65535
"""No depth in 16-bit images, as 0 is."""
DEPTH_SOURCE_KEYS = ("scale", "source", "unit", "error")
EXPECTED_DEPTH_IMAGE = "a depth image for each frame of clip.json that has one"


def depth_file(folder: Path, frame: str) -> str | None:
    """Name the depth image of a frame in a clip's folder; None where it has none."""
    names = (f"{DEPTH_KEY}/{frame}{suffix}" for suffix in DEPTH_SUFFIXES)
    return next((name for name in names if os.path.lexists(folder / name)), None)


def read_depth(clip: Clip) -> Depth | None:
    """Read the depth about hand and object in a clip's frames, an image at a time; None where its folder has none.

    Raises ``InputError`` for images of several sizes or of another shape than the clip's, for negative depth, where no
    image has depth about hand and object, and where all is too far away for the unit.
    """
    if clip.folder is None:
        return None
    if not os.path.lexists(clip.folder / DEPTH_KEY):
        about = clip.folder / "clip.json"  # a clip that is being made has none
        if about.is_file() and DEPTH_KEY in files.read_json(about):
            expected = f"the description of a folder {DEPTH_KEY}, or left out"
            raise InputError(about, DEPTH_KEY, "no such folder", expected)
        return None
    source = read_depth_source(clip.folder / "clip.json")
    names = [depth_file(clip.folder, frame) for frame in clip.frames]
    paths = [None if name is None else files.inside(clip.folder, name, "", EXPECTED_DEPTH_IMAGE) for name in names]
    first = next((path for path in paths if path is not None), None)
    if first is None:
        raise InputError(clip.folder / DEPTH_KEY, "", "no image named like a frame of the clip", EXPECTED_DEPTH_IMAGE)
    size = check_depth_shape(first, read_depth_image(first), clip.size)
    corner, stride = sampling_windows(clip, masks_in_memory(clip) or read_object_masks(clip), size)
    z = np.zeros((len(paths), N_WINDOW_SAMPLES, N_WINDOW_SAMPLES))
    for n, path in enumerate(paths):
        if path is not None:
            z[n] = source.unit * sample_window(read_depth_image(path, size), corner[n], int(stride[n]))
    depth = Depth(z, corner, stride, size, source)
    known = depth.z[depth.z > 0.0]
    if not known.size:
        raise InputError(clip.folder / DEPTH_KEY, "", "0 in all images about hand and object", "depth in some")
    if source.scale == "metric" and np.median(known) > MAX_METRIC_DEPTH_M:
        got = f"a median of {np.median(known):.4g} m about hand and object"
        raise InputError(
            clip.folder / "clip.json",
            f"{DEPTH_KEY}.unit",
            got,
            f"at most {MAX_METRIC_DEPTH_M:g} m: are these millimetres?",
        )
    return depth


def sensor_images(clip: Clip) -> Iterator[tuple[int, tuple[Float[ndarray, "h w"], Float[ndarray, "3 3"]]]]:
    """Yield the whole depth images [m] of a sensor in a clip's folder, by frame, and their intrinsics.

    Raises ``InputError``.
    """
    if clip.folder is None or not os.path.lexists(clip.folder / DEPTH_KEY):
        return
    source = read_depth_source(clip.folder / "clip.json")
    if (source.scale, source.source) != ("metric", "sensor"):
        return
    for n, frame in enumerate(clip.frames):
        if (name := depth_file(clip.folder, frame)) is not None:
            image = source.unit * read_depth_image(files.inside(clip.folder, name, "", EXPECTED_DEPTH_IMAGE))
            zoom = np.array(image.shape[::-1]) / np.array(clip.size)
            yield n, (image, np.diag([*zoom, 1.0]) @ clip.K[n])


def read_depth_source(path: Path) -> DepthSource:
    """Read what depth images are in a ``clip.json``. Raises ``InputError``."""
    stored = files.read_json(path).get(DEPTH_KEY)
    if not isinstance(stored, dict):
        raise InputError(path, DEPTH_KEY, shorten_value(stored), "an object: what the images in the folder depth are")
    return parse_depth_source(path, stored)


def parse_depth_source(path: Path, stored: Json) -> DepthSource:
    """Parse what depth images are. Raises ``InputError``."""
    allowed = {"scale": ("metric", "clip", "frame"), "source": ("sensor", "network")}
    unknown = next((key for key in stored if key not in DEPTH_SOURCE_KEYS), None)
    if unknown is not None:
        raise InputError(
            path, f"{DEPTH_KEY}.{files.printable(unknown)}", "an unknown key", f"one of {', '.join(DEPTH_SOURCE_KEYS)}"
        )
    for key, values in allowed.items():
        if stored.get(key) not in values:
            raise InputError(path, f"{DEPTH_KEY}.{key}", shorten_value(stored.get(key)), " or ".join(values))
    for key, most in {"unit": MAX_DEPTH_UNIT_M, "error": 1.0}.items():
        value = stored.get(key, 1.0 if key == "error" else None)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= most:
            raise InputError(path, f"{DEPTH_KEY}.{key}", shorten_value(value), f"a number above 0, at most {most:g}")
    return DepthSource(stored["scale"], stored["source"], float(stored["unit"]), float(stored.get("error", np.nan)))


def depth_source_fields(source: DepthSource) -> Json:
    """Return ``depth`` of ``clip.json``."""
    error = {} if np.isnan(source.error) else {"error": source.error}
    return {"scale": source.scale, "source": source.source, "unit": source.unit, **error}


def check_depth_shape(path: Path, image: Float[ndarray, "h w"], size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height of a depth image. Raises ``InputError`` for another shape than the clip's images have."""
    height, width = image.shape
    plausible.check_shape(path, "size", (width, height), size)
    return width, height


def read_depth_image(path: Path, size: tuple[int, int] | None = None) -> Float[ndarray, "h w"]:
    """Read a depth image in its file's unit, 0 where there is none; of a ``size`` if given. Raises ``InputError``."""
    image = DEPTH_READERS[path.suffix.lower()](path)
    if size is not None and image.shape != size[::-1]:
        value = f"{image.shape[1]} x {image.shape[0]} pixels"
        raise InputError(path, "size", value, f"{size[0]} x {size[1]}, as the first image")
    return image


def check_depth_array(path: Path, key: str, stored: ndarray) -> Float[ndarray, "h w"]:
    """Return an array as depth: 0 where it is not finite. Raises ``InputError`` for other arrays than of one image."""
    array = (
        stored.reshape(stored.shape[-2:]) if stored.ndim > 2 and stored.size == np.prod(stored.shape[-2:]) else stored
    )
    if array.ndim != 2 or array.dtype.kind not in "fiu" or not 0 < array.size <= MAX_DEPTH_PIXELS:
        got = f"{stored.dtype} of shape {stored.shape}"
        raise InputError(path, key, got, f"numbers of shape (height, width), at most {MAX_DEPTH_PIXELS} of them")
    image = np.where(np.isfinite(array), array, 0.0)
    if image.min() < 0.0:
        raise InputError(path, key, f"numbers down to {image.min():g}", "distances, 0 for none: no disparities")
    return np.asarray(image, dtype=float)


def read_png16(path: Path) -> Float[ndarray, "h w"]:
    """Read a 16-bit PNG of one channel. Raises ``InputError``."""
    image, colours, bits = open_png(path, png_size(path, MAX_DEPTH_PIXELS))
    if (colours, bits) != ("grey", 16):
        raise InputError(path, "channels", f"{bits} bit {colours}", "16 bit, one channel (grey)")
    values = np.array(image)
    return np.where(values == SATURATED_DEPTH, 0, values).astype(float)


def _read_npy_depth(path: Path) -> Float[ndarray, "h w"]:
    return check_depth_array(path, "", arrays.parse_npy(path, "", files.read_bytes(path, arrays.MAX_NPZ_BYTES)))


def _read_npz_depth(path: Path) -> Float[ndarray, "h w"]:
    stored = arrays.read(path, lambda _: True)
    key = DEPTH_KEY if DEPTH_KEY in stored else next(iter(stored), DEPTH_KEY)
    if key not in stored or (key != DEPTH_KEY and len(stored) > 1):
        raise InputError(path, DEPTH_KEY, f"{len(stored)} arrays without this one", "the array, or one alone")
    return check_depth_array(path, key, stored[key])


def _read_exr_depth(path: Path) -> Float[ndarray, "h w"]:
    return check_depth_array(path, "", read_channel(path, MAX_DEPTH_PIXELS))


DEPTH_READERS: dict[str, Callable[[Path], Float[ndarray, "h w"]]] = {
    ".png": read_png16, ".npy": _read_npy_depth, ".npz": _read_npz_depth, ".exr": _read_exr_depth
}  # fmt: skip


def write_clip_depth(clip: Clip, depth: Depth, folder: Path) -> None:
    """Write the depth of a clip into its new folder, and what it is into the ``clip.json`` there.

    Images in the clip's own folder are copied; of samples in memory, images are written that have these pixels alone.
    """
    fields, path = depth_source_fields(depth.source), folder / "clip.json"
    target = files.folder_inside(folder, DEPTH_KEY)
    for n, frame in enumerate(clip.frames):
        name = None if clip.folder is None else depth_file(clip.folder, frame)
        if clip.folder is not None and name is not None:
            files.write_bytes(
                folder / name, files.read_bytes(files.inside(clip.folder, name, "", EXPECTED_DEPTH_IMAGE))
            )
        elif depth.z[n].any():
            arrays.write(target / f"{frame}.npz", {DEPTH_KEY: (depth.image(n) / depth.source.unit).astype(np.float32)})
    files.write_json(path, {**files.read_json(path), DEPTH_KEY: fields})
