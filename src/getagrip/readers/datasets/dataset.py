"""The interface of a dataset reader: a dataclass of options, and parts that become clips in any process.

A reader subclasses ``Dataset``: its fields are the options of ``getagrip import <name>``, its docstring is the
command's help. ``getagrip.cli.datasets`` lists the readers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks
from getagrip.errors import InputError

Note = Callable[[str], None]
"""A function that reports skipped data, in words."""


class Missing(Protocol):
    """A function that returns whether a clip of some name is missing."""

    def __call__(self, name: str, with_hands: bool = False) -> bool:
        """``with_hands``: hands are available, so that an existing clip without hands counts as missing."""


@dataclass(frozen=True)
class Draft:
    """The functions that make one clip."""

    name: str
    make: Callable[[], tuple[Clip, Masks | None] | None]
    """Make the clip and its masks; None, after a note, where no frame is left. Raises ``InputError``."""
    images: Callable[[Clip], Sequence[UInt8[ndarray, "H W 3"]]] | None = None
    """Read the RGB images of the clip's frames, for datasets that store them in the clip. Raises ``InputError``."""
    hand: Callable[[Clip], tuple[HandTrack, Sequence[int]]] | None = None
    """Read the hand of a clip made without one, and the indices of its frames. Raises ``InputError``."""


class Part(Protocol):
    """A part of a dataset, as a sequence or a video, that one process reads. Picklable."""

    @property
    def name(self) -> str:
        """Name in messages."""

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        """Yield the missing clips of this part. Raises ``InputError``."""


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A dataset with the options of its import."""

    parts_are: ClassVar[str] = "sequences"
    """Name of the parts, in the plural."""

    def parts(self, note: Note) -> Sequence[Part]:
        """List the unread parts. Raises ``UsageError`` for wrong options, ``InputError`` where no part is found."""
        raise NotImplementedError

    def may_make(self, part: Part, names: Set[str]) -> bool:
        """Return whether a part may make a clip of one of some names, as far as is known before it is read."""
        return True

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how clips are cut to stable grasps, for the list beside them; None for uncut clips.

        Raises as ``parts`` does.
        """
        return None

    def advice(self, made: Sequence[Mapping[str, object]], handless: int) -> Iterator[str]:
        """Yield closing advice, from the provenance of the new clips and the number of clips without hands."""
        return iter(())


def clips(dataset: Dataset, note: Note = lambda _: None) -> Iterator[tuple[Clip, Masks | None]]:
    """Yield all clips of a dataset with their masks, one at a time in memory; nothing is written.

    Raises as ``Dataset.parts`` does. An ``InputError`` of a part is raised after all other parts: the first one, with a
    note on each further one.
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
