"""Images as files: each written whole or with an error; read only where they have the size that they should have.

Sizes are checked before memory is taken, and damaged files are refused. Decoders return what there is of a file that is
cut short or damaged. Pillow decodes PNG here: it can check every checksum first, and says how many bits a pixel has. Of
a JPEG a scan of a few bytes may take as long as a whole image, so they are counted first.
"""

from __future__ import annotations

import errno
import io
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, UInt8, UInt16
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.files import read_bytes

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

WRITTEN_JPEG_QUALITY = 92
"""Quality of JPEG images, of 100."""
MAX_JPEG_SCANS = 100
"""Passes over an image: 1 to 4 of plain ones, about 10 of those that load step by step."""
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])", re.DOTALL)
"""Start of a segment, wherever a decoder looks for one: in coded data, FF is followed by 00 or D0 to D7."""
JPEG_SCAN_MARKER, JPEG_END_MARKER = 0xDA, 0xD9
MAX_ENCODED_IMAGE_BYTES = 64 * 2**20
"""Limit of a file in bytes."""
PNG_END_CHUNK = b"\0\0\0\0IEND\xaeB`\x82"
"""The last chunk of every PNG."""
PNG_COLOUR_NAMES = {
    "1": "grey",
    "L": "grey",
    "I": "grey",
    "P": "palette",
    "LA": "grey and alpha",
    "RGB": "RGB",
    "RGBA": "RGB and alpha",
}
"""Pillow's names of a PNG's colours, and those in errors."""


def read_image(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Read red, green and blue of a PNG or JPEG of the given (width, height).

    Raises ``InputError``.

    The decoder that says how large an image is also decodes it: of a crafted file others may see another size.
    """
    if path.suffix.lower() == ".png":
        return read_colour_png(path, size)
    from PIL import ImageOps

    content = files.read_bytes(path, MAX_ENCODED_IMAGE_BYTES)
    try:
        image = open_jpeg(path, "", content)
        if size not in (image.size, image.size[::-1]):  # upright images may be stored on their side, with a note
            value, expected = (f"{width} x {height}" for width, height in (image.size, size))
            raise InputError(path, "size", f"{value} pixels", f"{expected}, the clip's size")
        upright = ImageOps.exif_transpose(image).convert("RGB")
    except InputError:
        raise
    except Exception as error:  # Pillow raises whatever its parsers meet
        raise InputError(path, "", f"a damaged file, or no JPEG ({error})", "a whole JPEG file") from error
    if upright.size != size:
        raise InputError(path, "size", "an image on its side", f"one of {size[0]} x {size[1]} pixels")
    return np.array(upright)


def decode_image(path: Path, key: str, content: bytes, largest: int) -> UInt8[ndarray, "H W 3"]:
    """Decode red, green and blue of a JPEG or PNG in memory, of at most ``largest`` pixels a side, upright.

    ``path`` and ``key`` are named in errors. Raises ``InputError``, for too large ones before memory is taken.
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
    except Exception as error:  # Pillow raises whatever its parsers meet
        raise InputError(path, key, f"an image that does not decode ({error})", "a JPEG or PNG image") from error


def write_image(path: Path, image: UInt8[ndarray, "H W"] | UInt8[ndarray, "H W 3"]) -> None:
    """Write a grey or RGB image as PNG or JPEG, by the suffix. Raises ``OSError``, as on a full disk.

    ``cv2.imwrite`` only returns False then.
    """
    import cv2

    _encode_image(path, image, [cv2.IMWRITE_JPEG_QUALITY, WRITTEN_JPEG_QUALITY] if path.suffix == ".jpg" else [])


def write_mask(path: Path, mask: Bool[ndarray, "H W"]) -> None:
    """Write a mask as a grey PNG, 255 where it is set; without a filter, so that it is read in half the time.

    Raises ``OSError``.
    """
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

    ``path`` and ``key`` are named in errors.

    Raises ``InputError`` for too many scans, and whatever Pillow meets.
    """
    from PIL.JpegImagePlugin import JpegImageFile

    scans, at = 0, 2
    while (marker := _JPEG_MARKER.search(content, at)) and content[marker.start() + 1] != JPEG_END_MARKER:
        scans += content[marker.start() + 1] == JPEG_SCAN_MARKER
        if scans > MAX_JPEG_SCANS:
            raise InputError(path, f"{key} scans".strip(), f"more than {MAX_JPEG_SCANS}", f"at most {MAX_JPEG_SCANS}")
        length = int.from_bytes(content[marker.end() : marker.end() + 2], "big")
        at = marker.end() + max(length, 2)  # as libjpeg goes on; of a scan, before its coded data
    return JpegImageFile(io.BytesIO(content))


def png_size(path: Path, most: int) -> tuple[int, int]:
    """Return width and height as a PNG's head states them. Raises ``InputError`` above ``most`` pixels."""
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
    """Read an 8-bit image of one channel and of the given (width, height). Raises ``InputError``."""
    image, colours, bits = open_png(path, size)
    if (colours, bits) != ("grey", 8):
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit, one channel (grey)")
    return np.array(image)


def read_colour_png(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Read red, green and blue of a PNG of the given (width, height), also of one with a palette.

    Raises ``InputError``.
    """
    image, colours, bits = open_png(path, size)
    if bits > 8:
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit")
    if image.mode == "RGB":
        return np.array(image)
    return np.ascontiguousarray(np.asarray(image.convert("RGBA"))[..., :3])  # by RGBA, palettes may be transparent


def open_png(path: Path, size: tuple[int, int]) -> tuple[PngImageFile, str, int]:
    """Read a PNG of the given (width, height); also return its kind of colours and the bits of each channel.

    Raises ``InputError``.
    """
    from PIL.PngImagePlugin import PngImageFile

    content = read_bytes(path, MAX_ENCODED_IMAGE_BYTES)
    try:
        stream = io.BytesIO(content)
        header = PngImageFile(stream)
        colours, _, bits = str(header.tile[0].args).partition(";")
        if header.size != size:
            value, expected = (f"{width} x {height}" for width, height in (header.size, size))
            raise InputError(path, "size", f"{value} pixels", f"{expected}, the size of the images")
        header.verify()  # up to the head of the last chunk
        if content[stream.tell() - 8 :] != PNG_END_CHUNK:
            raise InputError(path, "", "a PNG that does not end where it should", "a whole PNG file")
        image = PngImageFile(io.BytesIO(content))
        image.load()
    except InputError:
        raise
    except Exception as error:  # Pillow raises whatever its parsers meet
        raise InputError(path, "", f"a damaged file, or no PNG ({error})", "a whole PNG file") from error
    return image, PNG_COLOUR_NAMES[colours], 1 if colours == "1" else int(bits.rstrip("B") or 8)
