"""PNG images of labels: grey (1 to 16 bit), with a palette as SAM 2 and VOS benchmarks write them, or colour-coded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.io import files

GREY, PALETTE, GREY_AND_ALPHA = 0, 3, 4
"""Kinds of PNG."""


def read_labels(path: Path, size: tuple[int, int]) -> Int[ndarray, "H W"]:
    """The label of each pixel: a grey value, an index into the palette, or a colour as 0xRRGGBB.

    Sizes are checked before memory is taken. Raises ``InputError``.
    """
    import cv2

    content, depth, kind = files.whole_png(path, size)
    if kind == GREY_AND_ALPHA:
        raise InputError(path, "channels", "grey and alpha", "grey, a palette, or colours")
    if kind == PALETTE:  # decoders give colours, not indices: the same bytes as a grey image give these
        content = _as_grey(path, content)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != size[::-1]:
        raise InputError(path, "", "a PNG that does not decode", "a whole PNG file")
    if image.ndim == 3:
        blue, green, red = np.moveaxis(image[..., :3].astype(np.int64), -1, 0)
        return red << 16 | green << 8 | blue
    labels = image.astype(np.int64)
    return labels // (255 // (2**depth - 1)) if depth < 8 else labels  # grey values are spread over 0 to 255


def _as_grey(path: Path, content: bytes) -> bytes:
    """A palette PNG with its palette taken out."""
    out = bytearray(content[:8])
    for kind, data in files.png_chunks(path, content):
        if kind in {b"PLTE", b"tRNS", b"bKGD", b"hIST", b"sPLT", b"sBIT"}:
            continue
        new = data[:9] + bytes([GREY]) + data[10:] if kind == b"IHDR" else data
        out += struct.pack(">I", len(new)) + kind + new + struct.pack(">I", zlib.crc32(kind + new))
    return bytes(out)


def label_value(text: str, option: str) -> int:
    """A label from a command line: a whole number, or a colour as #rrggbb. Raises ``UsageError``."""
    try:
        value = int(text[1:], 16) if text.startswith("#") and len(text) == 7 else int(text)
    except ValueError:
        value = -1
    if not 0 <= value < 2**24:
        raise UsageError(f"{option}: got {text!r}, expected a label as 3, or a colour as #ff0000")
    return value
