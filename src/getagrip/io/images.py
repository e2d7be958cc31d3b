"""Image and video files, read at their expected size and written whole or not at all; masks packed in memory.

Sizes are checked before memory is taken, and damaged files are refused, though decoders return parts of them. Pillow
decodes PNG: it can verify every checksum first, and states the bits per pixel. JPEG scans are counted first: one of a
few bytes may take as long as a whole image.
"""

from __future__ import annotations

import errno
import io
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from jaxtyping import Bool, UInt8, UInt16
from numpy import ndarray
from numpy.lib.mixins import NDArrayOperatorsMixin

from getagrip.errors import GetagripError, InputError
from getagrip.io import files

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

WRITTEN_JPEG_QUALITY = 92
"""JPEG quality, up to 100."""
MAX_JPEG_SCANS = 100
"""Passes over an image: 1 to 4 for sequential JPEGs, about 10 for progressive ones."""
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])", re.DOTALL)
"""Start of a segment, as decoders search for it: in coded data, FF is followed by 00 or D0 to D7."""
JPEG_SCAN_MARKER, JPEG_END_MARKER = 0xDA, 0xD9
MAX_ENCODED_IMAGE_BYTES = 64 * 2**20
PNG_END_CHUNK = b"\0\0\0\0IEND\xaeB`\x82"
"""The last chunk of every PNG."""
PNG_COLOUR_NAMES = {
    "1": "grey", "L": "grey", "I": "grey", "P": "palette", "LA": "grey and alpha", "RGB": "RGB",
    "RGBA": "RGB and alpha",
}  # fmt: skip
"""Names of a PNG's colours in errors, by Pillow's."""
H264_CRF = "20"
"""H.264's constant rate factor: lower is better."""


def read_image(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Read red, green and blue of a PNG or JPEG of the given (width, height) [px]. Raises ``InputError``.

    One decoder both reads the size and decodes: in a crafted file, another decoder may see another size.
    """
    if path.suffix.lower() == ".png":
        return read_colour_png(path, size)
    from PIL import ImageOps

    content = files.read_bytes(path, MAX_ENCODED_IMAGE_BYTES)
    try:
        image = open_jpeg(path, "", content)
        if size not in (image.size, image.size[::-1]):  # Exif may state a rotation
            value, expected = (f"{width} x {height}" for width, height in (image.size, size))
            raise InputError(path, "size", f"{value} pixels", f"{expected}, the clip's size")
        upright = ImageOps.exif_transpose(image).convert("RGB")
    except InputError:
        raise
    except Exception as error:  # Pillow's parsers raise many types
        raise InputError(path, "", f"a damaged file, or no JPEG ({error})", "a whole JPEG file") from error
    if upright.size != size:
        raise InputError(path, "size", "an image on its side", f"one of {size[0]} x {size[1]} pixels")
    return np.array(upright)


def decode_image(path: Path, key: str, content: bytes, largest: int) -> UInt8[ndarray, "H W 3"]:
    """Decode red, green and blue of a JPEG or PNG in memory, of at most ``largest`` pixels a side, upright.

    ``path`` and ``key`` are named in errors. Raises ``InputError``, for too large images before memory is taken.
    """
    from PIL import ImageOps
    from PIL.PngImagePlugin import PngImageFile

    try:
        is_png = content[:4] == b"\x89PNG"
        image = PngImageFile(io.BytesIO(content)) if is_png else open_jpeg(path, key, content)
        if max(image.size) > largest:
            where = f"{key} size".strip()
            raise InputError(path, where, "{} x {} pixels".format(*image.size), f"at most {largest} px a side")
        return np.array(ImageOps.exif_transpose(image).convert("RGB"))
    except InputError:
        raise
    except Exception as error:  # Pillow's parsers raise many types
        raise InputError(path, key, f"an image that does not decode ({error})", "a JPEG or PNG image") from error


def write_image(path: Path, image: UInt8[ndarray, "H W"] | UInt8[ndarray, "H W 3"]) -> None:
    """Write a grey or RGB image as PNG or JPEG, by the suffix. Raises ``OSError``; ``cv2.imwrite`` returns False."""
    import cv2

    _encode_image(path, image, [cv2.IMWRITE_JPEG_QUALITY, WRITTEN_JPEG_QUALITY] if path.suffix == ".jpg" else [])


def write_mask(path: Path, mask: Bool[ndarray, "H W"]) -> None:
    """Write a mask as a grey PNG of 0 and 255, unfiltered to halve the time of reading. Raises ``OSError``."""
    import cv2

    _encode_image(path, mask.astype(np.uint8) * 255, [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE])


def write_depth(path: Path, depth: UInt16[ndarray, "H W"]) -> None:
    """Write a depth image as a 16-bit PNG. Raises ``OSError``."""
    _encode_image(path, depth, [])


def _encode_image(
    path: Path, image: UInt8[ndarray, "H W"] | UInt8[ndarray, "H W 3"] | UInt16[ndarray, "H W"], options: list[int]
) -> None:
    import cv2

    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    done, content = cv2.imencode(path.suffix, bgr, options)
    if not done:
        raise OSError(errno.EINVAL, "an image that cannot be encoded", str(path))
    files.write_bytes(path, content.tobytes())


def open_jpeg(path: Path, key: str, content: bytes) -> JpegImageFile:
    """Open a JPEG without decoding it.

    ``path`` and ``key`` are named in errors. Raises ``InputError`` for too many scans, and any error of Pillow.
    """
    from PIL.JpegImagePlugin import JpegImageFile

    scans, at = 0, 2
    while (marker := _JPEG_MARKER.search(content, at)) and content[marker.start() + 1] != JPEG_END_MARKER:
        scans += content[marker.start() + 1] == JPEG_SCAN_MARKER
        if scans > MAX_JPEG_SCANS:
            raise InputError(path, f"{key} scans".strip(), f"more than {MAX_JPEG_SCANS}", f"at most {MAX_JPEG_SCANS}")
        length = int.from_bytes(content[marker.end() : marker.end() + 2], "big")
        at = marker.end() + max(length, 2)  # as libjpeg continues; for a scan, at its coded data
    return JpegImageFile(io.BytesIO(content))


def png_size(path: Path, most: int) -> tuple[int, int]:
    """Read width and height [px] from a PNG's header. Raises ``InputError`` above ``most`` pixels."""
    if not path.is_file():
        raise InputError(path, "", "no such file", "a PNG file")
    with path.open("rb") as stream:
        head = stream.read(24)
    if len(head) < 24 or head[:4] != b"\x89PNG":
        raise InputError(path, "", "a damaged file, or no PNG", "a whole PNG file")
    width, height = struct.unpack(">II", head[16:24])
    if not 0 < width * height <= most:
        raise InputError(path, "size", f"{width} x {height} pixels", f"at most {most} pixels")
    return width, height


def read_png(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W"]:
    """Read an 8-bit image of one channel and of the given (width, height) [px]. Raises ``InputError``."""
    image, colours, bits = open_png(path, size)
    if (colours, bits) != ("grey", 8):
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit, one channel (grey)")
    return np.array(image)


def read_colour_png(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Read red, green and blue of a PNG of the given (width, height) [px], palettes included. Raises ``InputError``."""
    image, colours, bits = open_png(path, size)
    if bits > 8:
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit")
    if image.mode == "RGB":
        return np.array(image)
    return np.ascontiguousarray(np.asarray(image.convert("RGBA"))[..., :3])  # palettes may be transparent


def open_png(path: Path, size: tuple[int, int]) -> tuple[PngImageFile, str, int]:
    """Read a PNG of the given (width, height) [px]; also return its colours' name and the bits per channel.

    Raises ``InputError``.
    """
    from PIL.PngImagePlugin import PngImageFile

    content = files.read_bytes(path, MAX_ENCODED_IMAGE_BYTES)
    try:
        stream = io.BytesIO(content)
        header = PngImageFile(stream)
        colours, _, bits = str(header.tile[0].args).partition(";")
        if header.size != size:
            value, expected = (f"{width} x {height}" for width, height in (header.size, size))
            raise InputError(path, "size", f"{value} pixels", f"{expected}, the size of the images")
        header.verify()  # stops after the last chunk's head
        if content[stream.tell() - 8 :] != PNG_END_CHUNK:
            raise InputError(path, "", "a PNG that does not end where it should", "a whole PNG file")
        image = PngImageFile(io.BytesIO(content))
        image.load()
    except InputError:
        raise
    except Exception as error:  # Pillow's parsers raise many types
        raise InputError(path, "", f"a damaged file, or no PNG ({error})", "a whole PNG file") from error
    return image, PNG_COLOUR_NAMES[colours], 1 if colours == "1" else int(bits.rstrip("B") or 8)


def write_video(
    path: Path, frames: Iterable[UInt8[ndarray, "H W 3"]], rate: Fraction, size: tuple[int, int], seek: bool = False
) -> None:
    """Write RGB frames of one size, an even width and height [px], as an MP4 video with H.264.

    With ``seek``, every other frame decodes independently. Raises ``GetagripError`` if PyAV has no H.264 encoder.
    """
    import av

    try:
        av.codec.Codec("libx264", "w")
    except av.codec.codec.UnknownCodecError as error:
        raise GetagripError("PyAV was built without libx264: no film can be written") from error
    options = {"crf": H264_CRF} | ({"g": "2", "bf": "0"} if seek else {})
    with files.new_file(path) as part, av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as film:
        stream = film.add_stream("libx264", rate=rate, options=options)
        (stream.width, stream.height), stream.pix_fmt = size, "yuv420p"
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            film.mux(stream.encode(picture))
        film.mux(stream.encode())


@dataclass(frozen=True, eq=False)
class PackedMask:
    """The mask of one frame, a bit per pixel of its bounding box."""

    size: tuple[int, int]
    """Height and width of the image [px]."""
    top: int
    left: int
    width: int
    """Width of the box [px]; its height is that of ``bits``."""
    bits: UInt8[ndarray, "h _"]

    @staticmethod
    def of(mask: Bool[ndarray, "H W"]) -> PackedMask:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not rows.size:
            return PackedMask((mask.shape[0], mask.shape[1]), 0, 0, 0, np.zeros((0, 0), np.uint8))
        box = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        bits = np.packbits(box, axis=1)
        if box.all():
            bits = np.broadcast_to(bits[:1].copy(), bits.shape)  # one row in memory
        return PackedMask((mask.shape[0], mask.shape[1]), rows[0], columns[0], box.shape[1], bits)


@lru_cache(maxsize=4)
def _unpacked(frame: PackedMask) -> Bool[ndarray, "H W"]:
    """Unpack a mask, read-only because cached."""
    out = np.zeros(frame.size, dtype=bool)
    if frame.width:
        box = np.unpackbits(frame.bits, axis=1, count=frame.width).view(bool)
        out[frame.top : frame.top + len(box), frame.left : frame.left + frame.width] = box
    out.setflags(write=False)
    return out


class PackedMasks(NDArrayOperatorsMixin):
    """A read-only (T, H, W) array of booleans, packed.

    A frame is unpacked on access by its number or by iteration; a slice of frames stays packed. All other operations of
    arrays unpack everything, in as much memory.
    """

    dtype = np.dtype(bool)
    ndim = 3

    def __init__(self, frames: Sequence[PackedMask], size: tuple[int, int]) -> None:
        """Hold frames of one size (height, width) [px]."""
        self._frames, self._size = tuple(frames), size

    @staticmethod
    def of(masks: Iterable[Bool[ndarray, "H W"]], size: tuple[int, int]) -> PackedMasks:
        """Pack masks, which an iterator may make one by one. ``size``: width and height [px]."""
        return PackedMasks([PackedMask.of(mask) for mask in masks], (size[1], size[0]))

    def as_array(self) -> Bool[ndarray, "T H W"]:
        """Return the object itself, typed as an array."""
        return cast(ndarray, self)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, H, W)."""
        return len(self._frames), *self._size

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[Bool[ndarray, "H W"]]:
        return map(_unpacked, self._frames)

    def __getitem__(self, index: Any) -> PackedMasks | ndarray | np.bool_:
        if isinstance(index, int | np.integer):
            return _unpacked(self._frames[index])
        if isinstance(index, slice) or (isinstance(index, ndarray) and index.ndim == 1):
            return PackedMasks([self._frames[n] for n in np.arange(len(self))[index]], self._size)
        return np.asarray(self)[index]

    def any(self, axis: tuple[int, ...] | int | None = None, keepdims: bool = False) -> ndarray | np.bool_ | bool:
        """Reduce by logical or, as an array does."""
        if axis is None and not keepdims:
            return bool(self._shown.any())
        if axis == (1, 2):
            return self._shown[:, None, None] if keepdims else self._shown.copy()
        return np.asarray(self).any(axis=axis, keepdims=keepdims)

    @cached_property
    def _shown(self) -> Bool[ndarray, "T"]:
        """True for frames with a set pixel."""
        return np.array([frame.width > 0 for frame in self._frames], dtype=bool)

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> ndarray:
        out = np.zeros(self.shape, dtype=bool)
        for n, mask in enumerate(self):
            out[n] = mask
        return out if dtype is None else out.astype(dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **named: object) -> object:
        whole = (np.asarray(each) if isinstance(each, PackedMasks) else each for each in inputs)
        return getattr(ufunc, method)(*whole, **named)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)
