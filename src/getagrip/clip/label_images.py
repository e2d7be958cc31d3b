"""PNG images of labels: grey (1 to 16 bit), with a palette as SAM 2 and VOS benchmarks write them, or colour-coded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.io.png import open_png


def read_labels(path: Path, size: tuple[int, int]) -> Int[ndarray, "H W"]:
    """The label of each pixel: a grey value, an index into the palette, or a colour as 0xRRGGBB.

    Sizes are checked before memory is taken. Raises ``InputError``.
    """
    image, colours, bits = open_png(path, size)
    if colours == "grey and alpha" or (colours.startswith("RGB") and bits > 8):
        raise InputError(path, "channels", f"{bits} bit {colours}", "grey, a palette, or colours of 8 bit")
    labels = np.asarray(image).astype(np.int64)
    if labels.ndim == 3:
        red, green, blue = np.moveaxis(labels[..., :3], -1, 0)
        return red << 16 | green << 8 | blue
    spread = 255 // (2**bits - 1) if colours == "grey" and bits in (2, 4) else 1  # Pillow spreads these over 0 to 255
    return labels // spread


def label_value(text: str, option: str) -> int:
    """A label from a command line: a whole number, or a colour as #rrggbb. Raises ``UsageError``."""
    try:
        value = int(text[1:], 16) if text.startswith("#") and len(text) == 7 else int(text)
    except ValueError:
        value = -1
    if not 0 <= value < 2**24:
        raise UsageError(f"{option}: got {text!r}, expected a label as 3, or a colour as #ff0000")
    return value
