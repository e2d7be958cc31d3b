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
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from jaxtyping import Bool, Int, UInt8, UInt16
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
MASK_DEFLATE_LEVEL = 3
"""Level of zlib: masks of higher ones are a third smaller, and take three times as long to read."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
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
    """Write a mask as a grey PNG of one bit, unfiltered, which ``read_mask`` reads fastest. Raises ``OSError``."""
    header = struct.pack(">IIBBBBB", mask.shape[1], mask.shape[0], 1, 0, 0, 0, 0)
    rows = np.pad(np.packbits(mask, axis=1), [(0, 0), (1, 0)])
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), MASK_DEFLATE_LEVEL))
    parts = [struct.pack(">I", len(data)) + kind + data + _checksum(kind + data) for kind, data in chunks]
    files.write_bytes(path, b"".join([PNG_SIGNATURE, *parts, PNG_END_CHUNK]))


def _checksum(chunk: bytes) -> bytes:
    return struct.pack(">I", zlib.crc32(chunk))


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


def read_mask(path: Path, size: tuple[int, int]) -> PackedMask:
    """Read a grey mask of 8 bits or one and of the given (width, height) [px], set where not 0. Raises ``InputError``.

    Unfiltered masks of one bit, as ``write_mask`` writes them, are never unpacked.
    """
    image, content, colours, bits = _check_png(path, size)
    if colours != "grey" or bits not in (1, 8):
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit or 1 bit, one channel (grey)")
    if bits == 1 and not image.info.get("interlace"):
        rows = np.frombuffer(_inflate(path, content, size[1] * (1 + -(-size[0] // 8))), np.uint8).reshape(size[1], -1)
        if not rows[:, 0].any():
            return PackedMask.of_bits(rows[:, 1:], size[0])
    return PackedMask.of(np.asarray(_decode_png(path, content)).astype(bool, copy=False))


def _inflate(path: Path, content: bytes, length: int) -> bytes:
    """Decompress the data of a PNG with right checksums, of exactly a length. Raises ``InputError``."""
    chunks, at = [], len(PNG_SIGNATURE)
    while at < len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        chunks += [content[at + 8 : at + 8 + size]] if kind == b"IDAT" else []
        at += 12 + size
    try:
        stream = zlib.decompressobj()
        data = stream.decompress(b"".join(chunks), length)
        if len(data) == length and not stream.decompress(stream.unconsumed_tail, 1) and stream.eof:
            return data
    except zlib.error as error:
        raise _damaged(path, error) from error
    raise InputError(path, "", "a PNG with too few or too many pixels", "a whole PNG file")


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
    _, content, colours, bits = _check_png(path, size)
    return _decode_png(path, content), colours, bits


def _check_png(path: Path, size: tuple[int, int]) -> tuple[PngImageFile, bytes, str, int]:
    """Return a PNG's header, content, colours and bits, its checksums and size being right. Raises ``InputError``."""
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
    except InputError:
        raise
    except Exception as error:  # Pillow's parsers raise many types
        raise _damaged(path, error) from error
    return header, content, PNG_COLOUR_NAMES[colours], 1 if colours == "1" else int(bits.rstrip("B") or 8)


def _decode_png(path: Path, content: bytes) -> PngImageFile:
    """Decode a PNG in memory. Raises ``InputError``."""
    from PIL.PngImagePlugin import PngImageFile

    try:
        image = PngImageFile(io.BytesIO(content))
        image.load()
    except Exception as error:  # Pillow's parsers raise many types
        raise _damaged(path, error) from error
    return image


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(path, "", f"a damaged file, or no PNG ({error})", "a whole PNG file")


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
    """Eight pixels a byte, the first in the highest bit; beyond the box they are zero."""

    @staticmethod
    def of(mask: Bool[ndarray, "H W"], top: int = 0, left: int = 0, size: tuple[int, int] | None = None) -> PackedMask:
        """Pack a mask, or with ``size``, the height and width of the image, a part of one from row and column on."""
        size = size or (mask.shape[0], mask.shape[1])
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not rows.size:
            return PackedMask.empty(size)
        box = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        bits = np.packbits(box, axis=1)
        if box.all():
            bits = np.broadcast_to(bits[:1].copy(), bits.shape)  # one row in memory
        return PackedMask(size, top + int(rows[0]), left + int(columns[0]), box.shape[1], bits)

    @staticmethod
    def of_bits(bits: UInt8[ndarray, "H _"], width: int) -> PackedMask:
        """Pack a mask that is eight pixels a byte already; bits beyond ``width`` do not count."""
        size, rows, columns = (len(bits), width), np.flatnonzero(bits.any(axis=1)), np.flatnonzero(bits.any(axis=0))
        if not rows.size:
            return PackedMask.empty(size)
        near = bits[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        left = 8 * int(columns[0])
        shown = np.unpackbits(near, axis=1, count=min(8 * near.shape[1], width - left)).view(bool)
        return PackedMask.of(shown, int(rows[0]), left, size)

    @staticmethod
    def empty(size: tuple[int, int]) -> PackedMask:
        """Make a mask without a pixel, of an image of a height and width [px]."""
        return PackedMask(size, 0, 0, 0, np.zeros((0, 0), np.uint8))

    @staticmethod
    def full(size: tuple[int, int]) -> PackedMask:
        """Make a mask of all pixels of an image of a height and width [px]."""
        row = np.packbits(np.ones((1, size[1]), dtype=bool), axis=1)
        return PackedMask(size, 0, 0, size[1], np.broadcast_to(row, (size[0], row.shape[1])))

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(u0, v0, u1, v1) [px] of the bounding box, end exclusive; zeros for an empty mask."""
        return self.left, self.top, self.left + self.width, self.top + len(self.bits)

    def box_with(self, other: PackedMask) -> tuple[int, int, int, int]:
        """Return the box of the pixels of both masks; that of the other alone, if one is empty."""
        if not (self.width and other.width):
            return self.box if self.width else other.box
        a, b = self.box, other.box
        return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])

    @cached_property
    def area(self) -> int:
        """Number of pixels."""
        return int(np.bitwise_count(self.bits).sum(dtype=np.int64))

    @property
    def is_full(self) -> bool:
        """True for a mask of all pixels of the image."""
        return self.area == self.size[0] * self.size[1]

    @property
    def grown(self) -> PackedMask:
        """The mask with all of its pixels' neighbours."""
        if not self.width:
            return self
        (left, top, right, bottom), (height, width) = self.box, self.size
        near = self.part((left - 2, top - 2, right + 2, bottom + 2))
        near = near[2:] | near[1:-1] | near[:-2]
        near = near[:, 2:] | near[:, 1:-1] | near[:, :-2]  # of the box and a pixel around it, cut at the image's border
        above, before = int(top == 0), int(left == 0)
        inside = near[above : height - top + 1, before : width - left + 1]
        return PackedMask.of(inside, top - 1 + above, left - 1 + before, self.size)

    @property
    def unpacked(self) -> Bool[ndarray, "H W"]:
        """The mask as a read-only array."""
        return _unpacked(self)

    def at(self, rows: Int[ndarray, "*n"], columns: Int[ndarray, "*n"]) -> Bool[ndarray, "*n"]:
        """Return ``mask[rows, columns]``, pixel by pixel; False beyond the image."""
        i, j = rows - self.top, columns - self.left
        inside = (i >= 0) & (i < len(self.bits)) & (j >= 0) & (j < self.width)
        out, i, j = np.zeros(inside.shape, dtype=bool), i[inside], j[inside]
        out[inside] = self.bits[i, j // 8] >> (7 - j % 8) & 1
        return out

    def exceeds(self, other: PackedMask) -> bool:
        """Return whether the mask has a pixel that another of the same image lacks."""
        return self.area > other.area or bool((self.part(self.box) & ~other.part(self.box)).any())

    def part(self, box: tuple[int, int, int, int]) -> Bool[ndarray, "h w"]:
        """Unpack the pixels of a box (u0, v0, u1, v1), end exclusive, which may leave the image: False beyond."""
        (u0, v0, u1, v1), (left, top, right, bottom) = box, self.box
        out = np.zeros((v1 - v0, u1 - u0), dtype=bool)
        left, top, right, bottom = max(u0, left), max(v0, top), min(u1, right), min(v1, bottom)
        if left < right and top < bottom:
            first, end = (left - self.left) // 8, (right - self.left + 7) // 8
            rows = np.unpackbits(self.bits[top - self.top : bottom - self.top, first:end], axis=1)
            start = left - self.left - 8 * first
            out[top - v0 : bottom - v0, left - u0 : right - u0] = rows[:, start : start + right - left].view(bool)
        return out

    def grid(self, rows: Int[ndarray, "n"], columns: Int[ndarray, "m"]) -> Bool[ndarray, "n m"]:
        """Unpack ``mask[rows[:, None], columns]``, of rising rows and columns; False beyond the image."""
        out = np.zeros((len(rows), len(columns)), dtype=bool)
        (above, below), (before, behind) = (
            np.searchsorted(at, [first, first + length])
            for at, first, length in ((rows, self.top, len(self.bits)), (columns, self.left, self.width))
        )
        if above < below and before < behind:
            across = columns[before:behind] - self.left
            first = int(across[0]) // 8
            some = self.bits[:, first : int(across[-1]) // 8 + 1].take(rows[above:below] - self.top, axis=0)
            out[above:below, before:behind] = np.unpackbits(some, axis=1).take(across - 8 * first, axis=1).view(bool)
        return out


@lru_cache(maxsize=4)
def _unpacked(frame: PackedMask) -> Bool[ndarray, "H W"]:
    """Unpack a mask, read-only because cached."""
    out = np.zeros(frame.size, dtype=bool)
    left, top, right, bottom = frame.box
    out[top:bottom, left:right] = frame.part(frame.box)
    out.setflags(write=False)
    return out


class PackedMasks(NDArrayOperatorsMixin):
    """A read-only (T, H, W) array of booleans, packed.

    A frame is unpacked on access by its number or by iteration; a slice of frames stays packed. All other operations of
    arrays unpack everything, in as much memory. Code whose cost must not grow with the image reads ``frames``,
    ``boxes`` and ``areas``.

    Attributes:
        frames: the T masks, packed.
    """

    dtype = np.dtype(bool)
    ndim = 3

    def __init__(self, frames: Sequence[PackedMask], size: tuple[int, int]) -> None:
        """Hold frames of one size (height, width) [px]."""
        self.frames, self._size = tuple(frames), size

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
        return len(self.frames), *self._size

    @cached_property
    def boxes(self) -> Int[ndarray, "T 4"]:
        """(u0, v0, u1, v1) [px] of each mask's bounding box, end exclusive; zeros for an empty mask."""
        return np.array([frame.box for frame in self.frames], dtype=int).reshape(-1, 4)

    @cached_property
    def areas(self) -> Int[ndarray, "T"]:
        """Number of pixels of each mask."""
        return np.array([frame.area for frame in self.frames], dtype=int)

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Bool[ndarray, "H W"]]:
        return map(_unpacked, self.frames)

    def __getitem__(self, index: Any) -> PackedMasks | ndarray | np.bool_:
        if isinstance(index, int | np.integer):
            return _unpacked(self.frames[index])
        if isinstance(index, slice) or (isinstance(index, ndarray) and index.ndim == 1):
            return PackedMasks([self.frames[n] for n in np.arange(len(self))[index]], self._size)
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
        return np.array([frame.width > 0 for frame in self.frames], dtype=bool)

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


def pack_masks(masks: Bool[ndarray, "T H W"] | PackedMasks) -> PackedMasks:
    """Return packed masks as they are, and pack an array."""
    return masks if isinstance(masks, PackedMasks) else PackedMasks.of(masks, (masks.shape[2], masks.shape[1]))
