"""The terms of a modality, on the object and on the hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxtyping import Int
from numpy import ndarray

from getagrip.fitting.energy.hand_term import HandTerm
from getagrip.fitting.energy.term import Energy

HandEnergy = Callable[[int, Int[ndarray, "n"]], Sequence[HandTerm]]
"""A sum of terms on the hand, at a resolution and at some of a clip's frames, as ``Energy`` on the object."""


@dataclass(frozen=True)
class Terms:
    """Terms at a problem's frames, made when they are asked for.

    Attributes:
        object: on the object, or on object and hand; None: none.
        hand: on the hand alone, which count where it is unknown as well; None: none.
    """

    object: Energy | None = None
    hand: HandEnergy | None = None
