"""The object, and what hides it, by the labels of images.

Images are PNG: grey (1 to 16 bit), with a palette as SAM 2 and VOS benchmarks write them, or colour-coded. With alpha,
what is transparent is background.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.mask_request import MaskRequest, combine_hand_object_masks
from getagrip.clip.naming import MAX_NAMES_IN_ERROR
from getagrip.errors import InputError, UsageError
from getagrip.io.images import open_png

ALPHA_NOTE = "the alpha channel was used as the mask, in images"
MAX_LABEL_COLOURS = 64
"""Most colours of an image of labels; an image with more is a photograph, cut out."""


class LabelChoice:
    """Picks the object and what hides it from labels."""

    def __init__(self, request: MaskRequest) -> None:
        """Parse the labels; raise ``UsageError`` for an unknown form."""
        self.object = [parse_label(text, "--object") for text in request.object]
        self.ignore = [parse_label(text, "--ignore") for text in request.ignore]
        self.hand = [parse_label(text, "--hand") for text in request.hand]
        self.only: int | None = None
        self.others: set[str] = set()
        named = {"--object": request.object, "--ignore": request.ignore, "--hand": request.hand}
        self.unmet = {f"{option} {text}" for option, texts in named.items() for text in texts}

    def _meet(self, labels: Int[ndarray, "H W"]) -> None:
        """Note which of the labels that are named are in an image."""
        for named in list(self.unmet):
            if (labels == parse_label(named.split(" ", 1)[1], named)).any():
                self.unmet.discard(named)

    def __call__(self, path: Path, labels: Int[ndarray, "H W"]) -> FrameMasks:
        """Split an image into masks; raise ``InputError`` where no label is named and there are several."""
        self._meet(labels)
        ignored = np.isin(labels, [*self.ignore, *self.hand])
        hand = np.isin(labels, self.hand) if self.hand else None
        if self.object:
            visible = np.isin(labels, self.object)
            if not visible.any() and len(self.others) < MAX_NAMES_IN_ERROR:
                self.others.update(map(label_name, np.unique(labels)[:MAX_NAMES_IN_ERROR].tolist()))
            return combine_hand_object_masks(visible, ignored, hand)
        visible = (labels != 0) & ~ignored
        there = np.unique(labels[visible])
        self.only = int(there[0]) if self.only is None and there.size else self.only
        if there.size > 1 or (there.size and there[0] != self.only):
            some = ", ".join(map(label_name, np.union1d(there, [self.only or there[0]])[:MAX_NAMES_IN_ERROR].tolist()))
            raise InputError(path, "labels", f"several, {some}", "one, or the object's named by --object")
        return combine_hand_object_masks(visible, ignored, hand)


def label_name(label: int) -> str:
    return str(label) if label < 2**16 else f"#{label:06x}"


def read_label_image(path: Path, size: tuple[int, int], notes: Counter[str] | None = None) -> Int[ndarray, "H W"]:
    """Read the label of each pixel: a grey value, an index into the palette, or a colour as 0xRRGGBB.

    Where alpha varies, what is transparent has the label 0, and what is not has its colour's; its alpha counts alone
    where that is one colour, or too many for labels. ``notes`` counts the images in which it does. Sizes are checked
    before memory is taken. Raises ``InputError``.
    """
    image, colours, bits = open_png(path, size)
    if (colours == "grey and alpha" or colours.startswith("RGB")) and bits > 8:
        raise InputError(path, "channels", f"{bits} bit {colours}", "grey, a palette, or colours of 8 bit")
    values = np.asarray(image).astype(np.int64)
    labels = values
    if values.ndim == 3:
        red, green, blue = np.moveaxis(values[..., :3], -1, 0) if values.shape[2] > 2 else (0, 0, values[..., 0])
        labels = np.asarray(red << 16 | green << 8 | blue)
    if colours.endswith("alpha"):
        return _opaque_labels(labels, values[..., -1], Counter() if notes is None else notes)
    spread = 255 // (2**bits - 1) if colours == "grey" and bits in (2, 4) else 1  # Pillow spreads these over 0 to 255
    return labels // spread


def _opaque_labels(labels: Int[ndarray, "H W"], alpha: Int[ndarray, "H W"], notes: Counter[str]) -> Int[ndarray, "H W"]:
    """Return the labels of opaque pixels, by half of the largest alpha or more; 0 elsewhere."""
    there = np.unique(labels)
    if alpha.min() == alpha.max():
        hidden = alpha.max() == 0 and (there.size == 1 or there.size > MAX_LABEL_COLOURS)
        return np.zeros_like(labels) if hidden else labels
    opaque = 2 * alpha >= alpha.max()
    there = np.unique(labels[opaque])
    if 1 < there.size <= MAX_LABEL_COLOURS:
        return np.where(opaque, labels, 0)
    notes[ALPHA_NOTE] += 1
    return np.where(opaque, 255, 0)


def parse_label(text: str, option: str) -> int:
    """Parse a label of the command line: a whole number, or a colour as #rrggbb. Raises ``UsageError``."""
    try:
        value = int(text[1:], 16) if text.startswith("#") and len(text) == 7 else int(text)
    except ValueError:
        value = -1
    if not 0 <= value < 2**24:
        raise UsageError(f"{option} must be a label as 3, or a colour as #ff0000 (got {text!r})")
    return value
