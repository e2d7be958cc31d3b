"""A dataset whose parts have clips of every kind, which other processes can read, too."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from getagrip.clip import Clip, Masks
from getagrip.errors import InputError
from getagrip.readers.datasets.dataset import Dataset, Draft, Missing, Note
from helpers.clips import small_clip


@dataclass(frozen=True)
class Shelf:
    """A part with four clips: the second is damaged, of the third nothing is left. "endless" takes a minute."""

    name: str
    handless: bool = False

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        if self.name == "endless":
            time.sleep(60.0)
        for n in range(4):
            name = f"{self.name}-{n}"
            if missing(name, with_hands=not self.handless):
                yield Draft(name, partial(self.make, n, name, note))
        if self.name == "torn":
            raise InputError(self.name, "", "half a file", "a whole one")

    def make(self, n: int, name: str, note: Note) -> tuple[Clip, Masks | None] | None:
        clip, masks = small_clip()
        if n == 1:
            raise InputError(name, "", "a damaged file", "a whole one")
        if n == 2:
            note(f"{name}: nothing is visible: skipped")
            return None
        if self.handless:
            clip = replace(
                clip, hand=replace(clip.hand, vertices=clip.hand.vertices[:, :0], faces=clip.hand.faces[:0], regions={})
            )
        return replace(clip, name=name), masks


@dataclass(frozen=True, kw_only=True)
class Library(Dataset):
    parts_are = "shelves"

    shelves: tuple[Shelf, ...]

    def parts(self, note: Note) -> tuple[Shelf, ...]:
        return self.shelves

    def advice(self, made: object, handless: int) -> Iterator[str]:
        yield f"{handless} handless"
