"""Requests for masks, by frames and labels; the masks' reader; and labels of images.

Images of labels are PNG: grey (1 to 16 bit), with a palette (SAM 2, VOS benchmarks), or colour-coded. Transparent
pixels are background.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int, Integer
from numpy import ndarray

from getagrip.clip.clip import FrameMasks
from getagrip.clip.match_frames import (
    MAX_NAMES_IN_ERROR,
    check_frame_numbers,
    matching_names,
    rows_in_order,
    rows_of_frames,
    stem_of,
)
from getagrip.clip.read_arrays import check_shape
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.io.files import printable
from getagrip.io.images import open_png

RESIZED_MASKS_NOTE = "masks of {} x {} pixels were resized to {} x {}, in images"
MASK_ASPECT_TOLERANCE = 0.02
"""Maximum relative difference of the aspect ratios of masks and images, for sides rounded to whole numbers."""
MAX_MASK_PIXELS = 40_000_000


def combine_hand_object_masks(
    visible: Bool[ndarray, "H W"], hidden: Bool[ndarray, "H W"], hand: Bool[ndarray, "H W"] | None
) -> FrameMasks:
    """Combine the masks of a frame: the object's pixels take precedence, and the hand is ignored as well."""
    if hand is None:
        return FrameMasks(visible, hidden & ~visible)
    return FrameMasks(visible, (hidden | hand) & ~visible, hand & ~visible)


@dataclass(frozen=True)
class MaskReader:
    """A function that reads the masks of a frame, by its index; None for frames without. Raises ``InputError``."""

    source: Path
    read: Callable[[int], FrameMasks]
    known: Collection[int]
    """The frames with masks."""
    others: set[str] = field(default_factory=set)
    """Labels found so far in frames without the object, for errors about a missing label."""
    unmet: set[str] = field(default_factory=set)
    """Named labels, with their options, not found so far."""
    notes: dict[str, int] = field(default_factory=dict)
    """Notes on unusual content, with counts."""
    warnings: tuple[str, ...] = ()
    """Warnings about probably unintended content."""

    def __call__(self, n: int) -> FrameMasks | None:
        with arrays.convert_to_input_errors(self.source):
            return self.read(n) if n in self.known else None


@dataclass(frozen=True)
class MaskRequest:
    """A request for the masks of a clip's frames."""

    frames: tuple[str, ...]
    """Names, or numbers, of the frames."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    object: tuple[str, ...] = ()
    """Labels of the object; empty if the files have one label only."""
    ignore: tuple[str, ...] = ()
    """Labels of occluders."""
    hand: tuple[str, ...] = ()
    """Labels of the grasping hand, which need not be among the occluders."""
    ask_first: str = ""
    """The option for the number of the first frame's mask; empty if used."""
    counted: bool = False
    """True if the option was used: frames are numbered as the masks' files count them."""
    images: str = ""
    """Folder or name pattern that selects among several images of a frame."""
    ask_images: str = "--images"
    """The option for ``images``."""
    stretched: bool = False
    """True to take masks of another shape than the images as stretched."""

    def check_size(self, path: Path, key: str, size: tuple[int, int]) -> tuple[int, int]:
        """Return the width and height of a mask. Raises ``InputError`` for another shape than the images'."""
        if min(size) > 0 and size[0] * size[1] > MAX_MASK_PIXELS:
            raise InputError(path, key, f"{size[0]} x {size[1]} pixels", f"at most {MAX_MASK_PIXELS} pixels")
        if not self.stretched or min(size) < 1:
            try:
                check_shape(path, key, size, self.size, MASK_ASPECT_TOLERANCE)
            except InputError as error:
                hint = "; --stretched takes them for the images, stretched (Roboflow's resize)"
                raise InputError(path, key, error.got, f"{error.expected}{hint}") from error
        return size

    def resized(self, labels: Integer[ndarray, "h w"] | Bool[ndarray, "h w"], notes: Counter[str]) -> ndarray:
        """Return a mask or labels at the images' size, by nearest pixels."""
        (width, height), (h, w) = self.size, labels.shape
        if (w, h) == self.size:
            return labels
        notes[RESIZED_MASKS_NOTE.format(w, h, width, height)] += 1
        rows, columns = ((2 * np.arange(many) + 1) * few // (2 * many) for many, few in ((height, h), (width, w)))
        return np.ascontiguousarray(labels[rows[:, None], columns])

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` for masks apparently counted from another start than frames."""
        check_frame_numbers(self.frames, names, source, "mask", self.ask_first)

    def places(self, source: Path, names: Sequence[str]) -> dict[int, int]:
        """Match images to frames by file names; return the image's row by frame.

        Raises ``UsageError`` for images apparently counted from another start, ``InputError`` for two images of a
        frame, and without any image.
        """
        self.check_numbers(source, [stem_of(names[row]) for row in matching_names(names, self.images)])
        rows = rows_of_frames(names, self.frames, source, "mask", self.images, self.ask_images)
        if not rows:
            raise self.nothing(source, names)
        return rows

    def in_order(self, source: Path, count: int) -> dict[int, int]:
        """Match masks without names to frames. Raises ``UsageError`` as ``rows_in_order`` does."""
        return rows_in_order(count, self.frames, source, "mask", self.counted, self.ask_first or "--first")

    def nothing(self, source: Path, names: Sequence[str]) -> InputError:
        """Make the error for files without a mask of any frame."""
        some = ", ".join(map(printable, names[:2])) + (", ..." if len(names) > 2 else "")
        got = f"no mask of any of {len(self.frames)} frames" + (f" among {some}" if names else "")
        return InputError(source, "", got, f"masks named like the frames, as {printable(self.frames[0])}")


ALPHA_NOTE = "the alpha channel was used as the mask, in images"
MAX_LABEL_COLOURS = 64
"""Maximum number of colours of an image of labels; an image with more is a cut-out photograph."""


class LabelChoice:
    """A function that splits an image of labels into the masks of object, occluders and hand."""

    def __init__(self, request: MaskRequest) -> None:
        """Parse the named labels. Raises ``UsageError``."""
        self.object = [parse_label(text, "--object") for text in request.object]
        self.ignore = [parse_label(text, "--ignore") for text in request.ignore]
        self.hand = [parse_label(text, "--hand") for text in request.hand]
        self.only: int | None = None
        self.others: set[str] = set()
        named = {"--object": request.object, "--ignore": request.ignore, "--hand": request.hand}
        self.unmet = {f"{option} {text}" for option, texts in named.items() for text in texts}

    def _meet(self, labels: Int[ndarray, "H W"]) -> None:
        for named in list(self.unmet):
            if (labels == parse_label(named.split(" ", 1)[1], named)).any():
                self.unmet.discard(named)

    def __call__(self, path: Path, labels: Int[ndarray, "H W"]) -> FrameMasks:
        """Split an image of labels into masks. Raises ``InputError`` for several labels without a named one."""
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

    With varying alpha, transparent pixels have the label 0 and opaque ones their colour's; with one colour, or too many
    colours for labels, alpha alone is the mask, counted in ``notes``. Sizes are checked before memory is taken. Raises
    ``InputError``.
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
    """Return the labels of opaque pixels, with at least half of the maximum alpha; 0 in other pixels."""
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
