"""PNG images from strangers: their size is checked before memory is taken, and damaged files are refused.

Decoders return what there is of a file that is cut short or damaged. Pillow decodes here: it can check every checksum
first, and says how many bits a pixel has.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io.files import read_bytes

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngImageFile

LARGEST = 64 * 2**20
"""Limit of a file in bytes."""
END = b"\0\0\0\0IEND\xaeB`\x82"
"""The last chunk of every PNG."""
COLOURS = {
    "1": "grey",
    "L": "grey",
    "I": "grey",
    "P": "palette",
    "LA": "grey and alpha",
    "RGB": "RGB",
    "RGBA": "RGB and alpha",
}
"""What Pillow calls the colours of a PNG, and what errors call them."""


def read_png(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W"]:
    """An 8-bit image of one channel and of the given (width, height). Raises ``InputError``."""
    image, colours, bits = open_png(path, size)
    if (colours, bits) != ("grey", 8):
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit, one channel (grey)")
    return np.array(image)


def read_colour_png(path: Path, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Red, green and blue of a PNG of the given (width, height), also of one with a palette. Raises ``InputError``."""
    image, colours, bits = open_png(path, size)
    if bits > 8:
        raise InputError(path, "channels", f"{bits} bit {colours}", "8 bit")
    if image.mode == "RGB":
        return np.array(image)
    return np.ascontiguousarray(np.asarray(image.convert("RGBA"))[..., :3])  # by RGBA, palettes may be transparent


def open_png(path: Path, size: tuple[int, int]) -> tuple[PngImageFile, str, int]:
    """A whole PNG of the given (width, height), decoded; its kind of colours and the bits of each channel.

    Raises ``InputError``.
    """
    from PIL.PngImagePlugin import PngImageFile

    content = read_bytes(path, LARGEST)
    try:
        stream = io.BytesIO(content)
        header = PngImageFile(stream)
        colours, _, bits = str(header.tile[0].args).partition(";")
        if header.size != size:
            given, expected = (f"{width} x {height}" for width, height in (header.size, size))
            raise InputError(path, "size", f"{given} pixels", f"{expected}, the size of the images")
        header.verify()  # up to the head of the last chunk
        if content[stream.tell() - 8 :] != END:
            raise InputError(path, "", "a PNG that does not end where it should", "a whole PNG file")
        image = PngImageFile(io.BytesIO(content))
        image.load()
    except InputError:
        raise
    except Exception as error:  # Pillow raises whatever its parsers meet
        raise InputError(path, "", f"a damaged file, or no PNG ({error})", "a whole PNG file") from error
    return image, COLOURS[colours], 1 if colours == "1" else int(bits.rstrip("B") or 8)
