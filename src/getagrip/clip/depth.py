"""Depth images of a clip: read from ``depth/`` of its folder, and sampled around hand and object to save memory.

Files are 16-bit PNG, ``.npy``, ``.npz`` of one array, or OpenEXR: one channel of a single image of scan lines, plain or
deflated (https://openexr.com/en/latest/OpenEXRFileLayout.html). OpenCV's EXR reader is optional, and switched off by
default, as unsafe with untrusted files.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import read_arrays
from getagrip.clip.clip import Clip, Masks
from getagrip.clip.masks import masks_in_memory, read_object_masks
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes, project
from getagrip.io import arrays, files
from getagrip.io.array_data import ArrayData
from getagrip.io.files import Json, shorten_value
from getagrip.io.images import open_png, pack_masks, png_size

DEPTH_KEY = "depth"
"""Key of ``Clip.evidence`` and of ``clip.json``, and the folder of the images."""
DEPTH_SUFFIXES = (".png", ".npy", ".npz", ".exr")
DEPTH_SOURCE_KEYS = ("scale", "source", "unit", "error")
EXPECTED_DEPTH_IMAGE = "a depth image for each frame of clip.json that has one"
SATURATED_DEPTH = 65535
"""Value without depth in 16-bit images, like 0."""
MAX_DEPTH_PIXELS = 40_000_000
MAX_METRIC_DEPTH_M = 20.0
"""Median metric depth of hand and object above which the unit is wrong [m]."""
MIN_DEPTH_UNIT_M, MAX_DEPTH_UNIT_M = 1e-12, 1e6
"""Bounds of ``DepthSource.unit``."""
N_WINDOW_SAMPLES = 64
"""Samples along a side of a frame's window."""
WINDOW_MARGIN = 1.1
"""Ratio of a window's side to that of the box around hand and object."""
ASSUMED_DEPTH_ERROR = {"sensor": 0.003, "network": 0.01}
"""Assumed error of depth if a clip does not state it, as a fraction of the depth: 2 mm and 8 mm at arm's length."""
MAX_DEPTH_RATIO = 2.0
"""Maximum ratio between the hand's depth in metric images and in the clip; beyond, the images are not used."""
MIN_SURROUNDINGS_DEPTH_RATIO = 0.85
"""Minimum ratio of the depth around the object to the object's; below it, depth images are disparities."""
MIN_DEPTH_SAMPLES = 20
"""Minimum number of pixels on the object, and around it, for a comparison of their depths."""
EXR_MAGIC, SINGLE_IMAGE = 20000630, 2
"""The first two numbers of a file: OpenEXR, and version 2 without tiles, long names, deep data or parts."""
EXR_BLOCK_LINES = {0: 1, 2: 1, 3: 16}
"""Lines per block by compression: none, ZIPS, ZIP."""
EXR_DTYPES: dict[int, np.dtype[np.floating]] = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
MAX_EXR_BLOCK_BYTES, MAX_EXR_BYTES = 32 * 2**20, 2**30
"""Limits of a block with all channels, and of all blocks, unpacked."""
VIEW_FILE = "view.json"
"""The description of a further view, in its folder (``clip.views``)."""
EXR_DEPTH_CHANNELS = ("Z", "Y", "depth", "depth.Z", "R")
"""Names of the depth channel, the first found counts; else the file's first channel."""


@dataclass(frozen=True)
class DepthSource:
    """The source and unit of a clip's depth images: ``depth`` in ``clip.json``.

    Attributes:
        scale: ``metric``: depth in metres; ``clip``: up to an unknown factor of the clip; ``frame``: of each frame.
        source: ``sensor`` or ``network``.
        unit: the depth of 1 in a file [m, or up to the factor].
        error: error of depth apart from the factor, as a fraction of the depth; NaN: not stated.
    """

    scale: Literal["metric", "clip", "frame"]
    source: Literal["sensor", "network"]
    unit: float = 1.0
    error: float = np.nan

    @property
    def assumed_error(self) -> float:
        """The stated error, else ``ASSUMED_DEPTH_ERROR``."""
        return ASSUMED_DEPTH_ERROR[self.source] if np.isnan(self.error) else self.error


@dataclass(frozen=True, eq=False)
class Depth(ArrayData):
    """Depth at samples in a window around hand and object, in T frames.

    Attributes:
        z: (T, n, n) depth along the camera's axis, as ``source.scale`` states; 0 where unknown.
        corner: (T, 2) column and row of the first sample in the depth image.
        stride: (T,) distance between samples [px of the depth image].
        size: width and height of the depth images, which cover the same view as the clip's images.
        source: source and unit of the images.
    """

    z: Float[ndarray, "T n n"]
    corner: Int[ndarray, "T 2"]
    stride: Int[ndarray, "T"]
    size: tuple[int, int]
    source: DepthSource

    def __len__(self) -> int:
        return len(self.z)

    def take(self, index: Int[ndarray, "n"]) -> Depth:
        """Return the depth of some frames, in the given order."""
        return replace(self, z=self.z[index], corner=self.corner[index], stride=self.stride[index])

    def thinned(self, every: int) -> Depth:
        """Keep one sample in ``every`` of a row, and of a column."""
        return replace(self, z=self.z[:, ::every, ::every], stride=every * self.stride)

    def image(self, n: int) -> Float[ndarray, "h w"]:
        """Return the depth image of a frame, with the samples alone."""
        out, (width, height) = np.zeros(self.size[::-1]), self.size
        columns, rows = self.corner[n][:, None] + self.stride[n] * np.arange(self.z.shape[1])
        (left, right), (top, bottom) = np.searchsorted(columns, [0, width]), np.searchsorted(rows, [0, height])
        out[rows[top:bottom, None], columns[left:right]] = self.z[n, top:bottom, left:right]
        return out

    def intrinsics(self, clip: Clip) -> Float[ndarray, "T 3 3"]:
        """Return the intrinsics of the samples as pixels with centres at (j + 0.5, i + 0.5)."""
        zoom = np.array(self.size) / np.array(clip.size)
        M = np.zeros((len(self), 3, 3))
        M[:, 0, 0], M[:, 1, 1] = zoom[:, None] / self.stride
        M[:, :2, 2] = 0.5 - (self.corner + 0.5) / self.stride[:, None]
        M[:, 2, 2] = 1.0
        return M @ clip.K

    def of_masks(self, masks: Bool[ndarray, "T H W"], size: tuple[int, int]) -> Bool[ndarray, "T n n"]:
        """Sample masks of a ``size`` (width, height) [px] at the depth samples; False beyond the image."""
        found = np.zeros(self.z.shape, dtype=bool)
        frames = zip(pack_masks(masks).frames, self.corner, self.stride, strict=True)
        for n, (mask, corner, stride) in enumerate(frames):
            at = corner[:, None] + stride * np.arange(self.z.shape[-1])
            columns, rows = np.floor((at + 0.5) * (np.array(size) / np.array(self.size))[:, None]).astype(int)
            (left, right), (top, bottom) = np.searchsorted(columns, [0, size[0]]), np.searchsorted(rows, [0, size[1]])
            found[n, top:bottom, left:right] = mask.grid(rows[top:bottom], columns[left:right])
        return found


def description_file(folder: Path) -> Path:
    """Return the file that describes the folder of a clip or of one of its views."""
    return folder / (VIEW_FILE if os.path.lexists(folder / VIEW_FILE) else "clip.json")


def read_depth(clip: Clip) -> Depth | None:
    """Read the depth around hand and object in a clip's frames, an image at a time; None if its folder has none.

    Raises ``InputError`` for images of several sizes or of another shape than the clip's, for negative depth, if no
    image has depth around hand and object, and for a median depth that suggests another unit.
    """
    if clip.folder is None:
        return None
    about = description_file(clip.folder)
    if not os.path.lexists(clip.folder / DEPTH_KEY):  # missing in a clip that is being made
        if about.is_file() and DEPTH_KEY in files.read_json(about):
            expected = f"the description of a folder {DEPTH_KEY}, or left out"
            raise InputError(about, DEPTH_KEY, "no such folder", expected)
        return None
    source = read_depth_source(about)
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
        expected = f"at most {MAX_METRIC_DEPTH_M:g} m: are these millimetres?"
        raise InputError(about, f"{DEPTH_KEY}.unit", got, expected)
    return depth


def sensor_images(clip: Clip) -> Iterator[tuple[int, tuple[Float[ndarray, "h w"], Float[ndarray, "3 3"]]]]:
    """Yield the full depth images [m] of a sensor in a clip's folder, by frame, and their intrinsics [px].

    Raises ``InputError``.
    """
    if clip.folder is None or not os.path.lexists(clip.folder / DEPTH_KEY):
        return
    source = read_depth_source(description_file(clip.folder))
    if (source.scale, source.source) != ("metric", "sensor"):
        return
    for n, frame in enumerate(clip.frames):
        if (name := depth_file(clip.folder, frame)) is not None:
            image = source.unit * read_depth_image(files.inside(clip.folder, name, "", EXPECTED_DEPTH_IMAGE))
            zoom = np.array(image.shape[::-1]) / np.array(clip.size)
            yield n, (image, np.diag([*zoom, 1.0]) @ clip.K[n])


def write_clip_depth(clip: Clip, depth: Depth, folder: Path) -> None:
    """Write the depth of a clip into its new folder, and its description into the JSON file of that folder.

    Images in the clip's own folder are copied; samples in memory become images with these pixels alone.
    """
    fields, path = depth_source_fields(depth.source), description_file(folder)
    target = files.folder_inside(folder, DEPTH_KEY)
    for n, frame in enumerate(clip.frames):
        name = None if clip.folder is None else depth_file(clip.folder, frame)
        if clip.folder is not None and name is not None:
            image = files.inside(clip.folder, name, "", EXPECTED_DEPTH_IMAGE)
            files.write_bytes(folder / name, files.read_bytes(image))
        elif depth.z[n].any():
            arrays.write(target / f"{frame}.npz", {DEPTH_KEY: (depth.image(n) / depth.source.unit).astype(np.float32)})
    files.write_json(path, {**files.read_json(path), DEPTH_KEY: fields})


def depth_file(folder: Path, frame: str) -> str | None:
    """Name the depth image of a frame in a clip's folder; None without one."""
    names = (f"{DEPTH_KEY}/{frame}{suffix}" for suffix in DEPTH_SUFFIXES)
    return next((name for name in names if os.path.lexists(folder / name)), None)


def surroundings_depth_ratio(
    z: Float[ndarray, "h w"], seen: Bool[ndarray, "h w"], others: Bool[ndarray, "h w"]
) -> float:
    """Return the ratio of the depth around the ``seen`` object to the object's, in a depth image.

    ``others`` occlude the object and do not count. NaN with fewer than ``MIN_DEPTH_SAMPLES`` of either.
    """
    rows, columns = np.nonzero(seen)
    if not len(rows):
        return np.nan
    ends = [(int(at.min()), int(at.max()) + 1, (int(np.ptp(at)) + 2) // 2) for at in (rows, columns)]
    box = tuple(slice(max(low - more, 0), high + more) for low, high, more in ends)
    near, far = (z[box][mask & (z[box] > 0.0)] for mask in (seen[box], ~seen[box] & ~others[box]))
    return float(np.median(far) / np.median(near)) if min(len(near), len(far)) >= MIN_DEPTH_SAMPLES else np.nan


def median_surroundings_depth_ratio(depth: Depth, masks: Masks, size: tuple[int, int]) -> float:
    """Return the median over frames of ``surroundings_depth_ratio``; ``size``: the masks' width and height [px]."""
    seen, others = depth.of_masks(masks.object, size), depth.of_masks(masks.ignore, size)
    each = np.array([surroundings_depth_ratio(*one) for one in zip(depth.z, seen, others, strict=True)])
    return float(np.median(each[np.isfinite(each)])) if np.isfinite(each).any() else np.nan


def sampling_windows(clip: Clip, masks: Masks, size: tuple[int, int]) -> tuple[Int[ndarray, "T 2"], Int[ndarray, "T"]]:
    """Return corner and stride of each frame's window around hand and object, in depth images of a ``size`` [px]."""
    uv = project(clip.K, se3.transform(clip.hand.T_cam_hand, clip.hand.vertices))
    boxes = bounding_boxes(masks.object)
    seen = (boxes[:, 2] > boxes[:, 0])[:, None]
    low = np.where(seen, np.minimum(uv.min(axis=1), boxes[:, :2]), uv.min(axis=1))
    high = np.where(seen, np.maximum(uv.max(axis=1), boxes[:, 2:]), uv.max(axis=1))
    low, high = np.clip(low, 0, clip.size), np.clip(high, 0, clip.size)
    zoom = np.array(size) / np.array(clip.size)
    stride = np.maximum(np.ceil(WINDOW_MARGIN * ((high - low) * zoom).max(axis=1) / N_WINDOW_SAMPLES), 1.0).astype(int)
    corner = np.floor((low + high) / 2.0 * zoom - stride[:, None] * N_WINDOW_SAMPLES / 2.0).astype(int)
    return corner, stride


def sample_window(image: Float[ndarray, "h w"], corner: Int[ndarray, "2"], stride: int) -> Float[ndarray, "n n"]:
    """Sample a depth image in a window; 0 beyond the image."""
    out = np.zeros((N_WINDOW_SAMPLES, N_WINDOW_SAMPLES))
    columns, rows = corner[:, None] + stride * np.arange(N_WINDOW_SAMPLES)
    height, width = image.shape
    (left, right), (top, bottom) = np.searchsorted(columns, [0, width]), np.searchsorted(rows, [0, height])
    out[top:bottom, left:right] = image[rows[top:bottom, None], columns[left:right]]
    return out


def read_depth_source(path: Path) -> DepthSource:
    """Read the description of depth images in the JSON file of a clip or a view. Raises ``InputError``."""
    stored = files.read_json(path).get(DEPTH_KEY)
    if not isinstance(stored, dict):
        raise InputError(path, DEPTH_KEY, shorten_value(stored), "an object: what the images in the folder depth are")
    return parse_depth_source(path, stored)


def parse_depth_source(path: Path, stored: Json) -> DepthSource:
    """Parse a description of depth images. Raises ``InputError``."""
    allowed = {"scale": ("metric", "clip", "frame"), "source": ("sensor", "network")}
    unknown = next((key for key in stored if key not in DEPTH_SOURCE_KEYS), None)
    if unknown is not None:
        key, known = f"{DEPTH_KEY}.{files.printable(unknown)}", ", ".join(DEPTH_SOURCE_KEYS)
        raise InputError(path, key, "an unknown key", f"one of {known}")
    for key, values in allowed.items():
        if stored.get(key) not in values:
            raise InputError(path, f"{DEPTH_KEY}.{key}", shorten_value(stored.get(key)), " or ".join(values))
    for key, most in {"unit": MAX_DEPTH_UNIT_M, "error": 1.0}.items():
        value = stored.get(key, 1.0 if key == "error" else None)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= most:
            raise InputError(path, f"{DEPTH_KEY}.{key}", shorten_value(value), f"a number above 0, at most {most:g}")
    return DepthSource(stored["scale"], stored["source"], float(stored["unit"]), float(stored.get("error", np.nan)))


def depth_source_fields(source: DepthSource) -> Json:
    """Return the content of ``depth`` in ``clip.json``."""
    error = {} if np.isnan(source.error) else {"error": source.error}
    return {"scale": source.scale, "source": source.source, "unit": source.unit, **error}


def check_depth_shape(path: Path, image: Float[ndarray, "h w"], size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height of a depth image [px]. Raises ``InputError`` for another shape than the clip's images."""
    height, width = image.shape
    read_arrays.check_shape(path, "size", (width, height), size)
    return width, height


def read_depth_image(path: Path, size: tuple[int, int] | None = None) -> Float[ndarray, "h w"]:
    """Read a depth image in its file's unit, 0 for unknown; optionally of a ``size`` [px]. Raises ``InputError``."""
    image = DEPTH_READERS[path.suffix.lower()](path)
    if size is not None and image.shape != size[::-1]:
        value = f"{image.shape[1]} x {image.shape[0]} pixels"
        raise InputError(path, "size", value, f"{size[0]} x {size[1]}, as the first image")
    return image


def check_depth_array(path: Path, key: str, stored: ndarray) -> Float[ndarray, "h w"]:
    """Return an array as a depth image, 0 where not finite. Raises ``InputError`` unless it is a single image."""
    single = stored.ndim > 2 and stored.size == np.prod(stored.shape[-2:])
    array = stored.reshape(stored.shape[-2:]) if single else stored
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


def read_channel(path: Path, most: int) -> Float[ndarray, "H W"]:
    """Read the depth channel of an EXR file of at most ``most`` pixels. Raises ``InputError``."""
    content = files.read_bytes(path)
    try:
        return _decode_channel(path, content, most)
    except InputError:
        raise
    except (struct.error, ValueError, KeyError, IndexError, OverflowError, zlib.error) as error:
        raise InputError(path, "", f"a damaged file ({error})", "a whole EXR file") from error


def _decode_channel(path: Path, content: bytes, most: int) -> Float[ndarray, "H W"]:
    if struct.unpack_from("<ii", content) != (EXR_MAGIC, SINGLE_IMAGE):
        raise InputError(path, "", "no EXR file of one image of scan lines", "such a file, as OpenCV writes it")
    header, start = _parse_exr_header(content)
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height, compression = right - left + 1, bottom - top + 1, header["compression"][0]
    if min(width, height) < 1 or width * height > most:
        raise InputError(path, "dataWindow", f"{width} x {height} pixels", f"at most {most} pixels")
    if compression not in EXR_BLOCK_LINES:
        raise InputError(path, "compression", f"kind {compression}", "none, ZIPS or ZIP")
    channels = _parse_channel_types(header["channels"])
    wanted = next((name for name in EXR_DEPTH_CHANNELS if name in channels), next(iter(channels)))
    offsets, row = {}, 0
    for name, dtype in channels.items():  # each line has the channels one after the other
        offsets[name], row = row, row + dtype.itemsize * width
    lines = EXR_BLOCK_LINES[compression]
    if row * lines > MAX_EXR_BLOCK_BYTES or row * height > MAX_EXR_BYTES:
        got, limits = f"{len(channels)} channels of {width} x {height} pixels", (MAX_EXR_BLOCK_BYTES, MAX_EXR_BYTES)
        raise InputError(path, "channels", got, "blocks of at most {} bytes, {} in all".format(*limits))
    out = np.zeros((height, width))
    for at in struct.unpack_from(f"<{-(-height // lines)}q", content, start):
        y, size = struct.unpack_from("<ii", content, at)
        first = y - top
        count = min(lines, height - first)
        if not 0 <= first < height or size < 0:
            raise ValueError("a block of other lines")
        inflated = _inflate_block(content[at + 8 : at + 8 + size], row * count)
        block = np.frombuffer(inflated, np.uint8).reshape(count, row)
        part = block[:, offsets[wanted] :][:, : channels[wanted].itemsize * width]
        out[first : first + count] = np.ascontiguousarray(part).view(channels[wanted])
    return out


def _parse_exr_header(content: bytes) -> tuple[dict[str, bytes], int]:
    """Parse the header's values by name, and its end."""
    header, at = dict[str, bytes](), 8
    while content[at]:
        name, kind = content.index(0, at), content.index(0, content.index(0, at) + 1)
        (size,) = struct.unpack_from("<i", content, kind + 1)
        if size < 0:
            raise ValueError("a negative size")
        header[content[at:name].decode("latin-1")] = content[kind + 5 : kind + 5 + size]
        at = kind + 5 + size
    return header, at + 1


def _parse_channel_types(value: bytes) -> dict[str, np.dtype[np.floating]]:
    """Parse the type of each channel, in the file's order."""
    found: dict[str, np.dtype[np.floating]] = {}
    at = 0
    while value[at]:
        end = value.index(0, at)
        kind, _, x, y = struct.unpack_from("<iiii", value, end + 1)
        if (x, y) != (1, 1):
            raise ValueError("a channel of another size")
        found[value[at:end].decode("latin-1")] = EXR_DTYPES[kind]
        at = end + 17
    return found


def _inflate_block(stored: bytes, size: int) -> bytes:
    """Inflate a block of lines, and undo its differences of neighbours, even bytes before odd ones."""
    if len(stored) == size:
        return stored
    inflated = np.frombuffer(zlib.decompressobj().decompress(stored, size + 1), np.uint8)
    if len(inflated) != size:
        raise ValueError("a block of another size")
    values = np.cumsum(inflated, dtype=np.uint8)
    values[1::2] ^= 128  # each difference has 128 added, modulo 256
    out = np.empty(size, np.uint8)
    out[::2], out[1::2] = np.split(values, [(size + 1) // 2])
    return out.tobytes()


DEPTH_READERS: dict[str, Callable[[Path], Float[ndarray, "h w"]]] = {
    ".png": read_png16, ".npy": _read_npy_depth, ".npz": _read_npz_depth, ".exr": _read_exr_depth
}  # fmt: skip
