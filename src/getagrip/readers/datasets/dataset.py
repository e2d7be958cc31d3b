"""The interface of a dataset: a dataclass of options, and parts that become clips in any process.

A reader subclasses ``Dataset``. Its fields are the options of ``getagrip import <name>``, its docstring the command's
help. ``getagrip.cli.datasets`` lists the readers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks
from getagrip.errors import InputError

Note = Callable[[str], None]
"""Reports in words what is skipped."""


class Missing(Protocol):
    """A function that returns whether a clip is yet to be made."""

    def __call__(self, name: str, with_hands: bool = False) -> bool:
        """``with_hands``: hands are known now, so that a clip that was made without them is made again."""


@dataclass(frozen=True)
class Draft:
    """A clip that is yet to be made."""

    name: str
    make: Callable[[], tuple[Clip, Masks | None] | None]
    """The clip and its masks; None, after a note, where nothing is left of it. Raises ``InputError``."""
    images: Callable[[Clip], Sequence[UInt8[ndarray, "H W 3"]]] | None = None
    """Reads the RGB images of the clip's frames, where they belong into its folder. Raises ``InputError``."""
    hand: Callable[[Clip], tuple[HandTrack, Sequence[int]]] | None = None
    """Reads the hand where the clip has none yet: in some of its frames, and which these are. Raises ``InputError``."""


class Part(Protocol):
    """A part of a dataset that one process reads, as a sequence or a video. It can be sent to another process."""

    @property
    def name(self) -> str:
        """Name in messages."""

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        """Yield the clips of this part that are ``missing``. Raises ``InputError``."""


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A dataset that is imported with certain options."""

    parts_are: ClassVar[str] = "sequences"
    """Name of its parts, in the plural."""

    def parts(self, note: Note) -> Sequence[Part]:
        """List its parts, yet to be read.

        Raises ``UsageError`` for wrong options, ``InputError`` where no part is found.
        """
        raise NotImplementedError

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how its clips are cut to stable grasps, for the list beside them.

        It is None where clips are not cut. Raises as ``parts`` does.
        """
        return None

    def advice(self, made: Sequence[Mapping[str, object]], handless: int) -> Iterator[str]:
        """Yield advice for the end, given the provenance of the clips made and the number of clips that lack hands."""
        return iter(())


def clips(dataset: Dataset, note: Note = lambda _: None) -> Iterator[tuple[Clip, Masks | None]]:
    """Yield all clips of a dataset, one at a time in memory; nothing is written.

    Raises as ``Dataset.parts`` does, and ``InputError`` for malformed files: the first one when all other parts are
    done, after a note on each of the others.
    """
    failed: list[InputError] = []
    for part in dataset.parts(note):
        try:
            for draft in part.drafts(lambda name, with_hands=False: True, note):
                made = draft.make()
                if made is not None:
                    yield made if draft.hand is None else _clip_with_hand(*made, *draft.hand(made[0]))
        except InputError as error:
            failed.append(error)
    for other in failed[1:]:
        note(f"failed: {other}")
    if failed:
        raise failed[0]


def _clip_with_hand(clip: Clip, masks: Masks | None, hand: HandTrack, rows: Sequence[int]) -> tuple[Clip, Masks | None]:
    index = np.array(rows, dtype=int)
    return replace(clip.take(index), hand=hand), masks and masks.take(index)
