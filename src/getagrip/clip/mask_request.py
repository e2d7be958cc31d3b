"""Masks that are looked for in other programs' files: in which frames, of which labels; and their reader."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Integer
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.naming import check_frame_numbers, matching_names, rows_in_order, rows_of_frames, stem_of
from getagrip.clip.plausible import check_shape
from getagrip.errors import InputError
from getagrip.io import files, numbers

RESIZED_MASKS_NOTE = "masks of {} x {} pixels were resized to {} x {}, in images"
MASK_ASPECT_TOLERANCE = 0.02
"""Largest difference of a mask's shape from that of the images: sides are whole numbers."""
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
    """The masks of a frame, by its index; None for a frame that has none. Calling it raises ``InputError``."""

    source: Path
    read: Callable[[int], FrameMasks]
    known: Collection[int]
    """The frames that have masks."""
    others: set[str] = field(default_factory=set)
    """Labels that were met so far in frames without the object, for an error about a label that is nowhere."""
    unmet: set[str] = field(default_factory=set)
    """Labels that were named, with their options, and not met so far."""
    notes: dict[str, int] = field(default_factory=dict)
    """Notes on how unusual content was read, with counts."""
    warnings: tuple[str, ...] = ()
    """Warnings about content that is probably not what was meant."""

    def __call__(self, n: int) -> FrameMasks | None:
        with numbers.convert_to_input_errors(self.source):
            return self.read(n) if n in self.known else None


@dataclass(frozen=True)
class MaskRequest:
    """A request for the masks of a clip's frames."""

    frames: tuple[str, ...]
    """Names, or numbers, of the frames."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    object: tuple[str, ...] = ()
    """Labels of the object; where none is named, there may be one only."""
    ignore: tuple[str, ...] = ()
    """Labels of what hides it."""
    hand: tuple[str, ...] = ()
    """Those of the things that are the grasping hand; it need not be among the others."""
    ask_first: str = ""
    """The option that states the number of the first frame's mask, where it was not used."""
    counted: bool = False
    """True if it was used: frames are numbered as the masks' files count them."""
    images: str = ""
    """Which of the images are meant, where there are several of a frame: a folder, or a pattern of their names."""
    ask_images: str = "--images"
    """The option that says so."""

    stretched: bool = False
    """True if masks of another shape than the images are these images', stretched."""

    def check_size(self, path: Path, key: str, size: tuple[int, int]) -> tuple[int, int]:
        """Return the width and height of a mask. Raises ``InputError`` for another shape than the images have."""
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
        """Return a mask or labels at the images' size: of each pixel the nearest one's."""
        (width, height), (h, w) = self.size, labels.shape
        if (w, h) == self.size:
            return labels
        notes[RESIZED_MASKS_NOTE.format(w, h, width, height)] += 1
        rows, columns = ((2 * np.arange(many) + 1) * few // (2 * many) for many, few in ((height, h), (width, w)))
        return np.ascontiguousarray(labels[rows[:, None], columns])

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` where masks seem to be counted from another start than frames."""
        check_frame_numbers(self.frames, names, source, "mask", self.ask_first)

    def places(self, source: Path, names: Sequence[str]) -> dict[int, int]:
        """Match images to frames by their file names, for the frames that have one.

        Raises ``UsageError`` where they seem to be counted from another start, and ``InputError`` where a frame has
        two, or none has one.
        """
        self.check_numbers(source, [stem_of(names[row]) for row in matching_names(names, self.images)])
        rows = rows_of_frames(names, self.frames, source, "mask", self.images, self.ask_images)
        if not rows:
            raise self.nothing(source, names)
        return rows

    def in_order(self, source: Path, count: int) -> dict[int, int]:
        """Match masks without names to frames. Raises ``UsageError`` as ``naming.rows_in_order`` does."""
        return rows_in_order(count, self.frames, source, "mask", self.counted, self.ask_first or "--first")

    def nothing(self, source: Path, names: Sequence[str]) -> InputError:
        """Make the error that there is no mask of any frame."""
        some = ", ".join(map(files.printable, names[:2])) + (", ..." if len(names) > 2 else "")
        got = f"no mask of any of {len(self.frames)} frames" + (f" among {some}" if names else "")
        return InputError(source, "", got, f"masks named like the frames, as {files.printable(self.frames[0])}")
