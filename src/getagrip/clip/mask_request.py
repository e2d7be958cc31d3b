"""Masks that are looked for in other programs' files: in which frames, of which labels; and their reader."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.numbering import check_numbers

MOST_NAMED = 12
"""Labels that an error lists."""


def without_object(
    visible: Bool[ndarray, "H W"], hidden: Bool[ndarray, "H W"], hand: Bool[ndarray, "H W"] | None
) -> FrameMasks:
    """The masks of a frame: where the object's lies over the others it counts, and the hand is ignored as well."""
    if hand is None:
        return FrameMasks(visible, hidden & ~visible)
    return FrameMasks(visible, (hidden | hand) & ~visible, hand & ~visible)


@dataclass(frozen=True)
class MaskReader:
    """The masks of a frame, by its index. Calling it raises ``InputError``."""

    source: Path
    read: Callable[[int], FrameMasks]
    others: set[str] = field(default_factory=set)
    """Labels that were met so far in frames without the object, for an error about a label that is nowhere."""

    def __call__(self, n: int) -> FrameMasks:
        return self.read(n)


@dataclass(frozen=True)
class MaskRequest:
    """What to look for."""

    frames: tuple[str, ...]
    """Names, or numbers, of the frames."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    object: tuple[str, ...] = ()
    """Labels of the object; where none is named, there may be one only."""
    ignore: tuple[str, ...] = ()
    """Labels of what hides it."""
    hand: tuple[str, ...] = ()
    """Of these the hand that holds it, which need not be among them."""
    ask_first: str = ""
    """The option that states the number of the first frame's mask, where it was not used."""

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` where masks seem to be counted from another start than frames."""
        check_numbers(self.frames, names, source, "mask", self.ask_first)
