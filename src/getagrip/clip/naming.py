"""Which frame of a clip a file from another program belongs to, by its name."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"(\d{1,12})$")
_PERSON = re.compile(r"_\d{1,2}$|_\d{1,2}_3dkeypoints$|_prediction_result$")
"""What estimators add to an image's name: HaMeR a person's number, FrankMocap two words."""


def number_of(name: str) -> int | None:
    """The number at the end of a name; None where there is none."""
    found = _NUMBER.search(name)
    return int(found[1]) if found else None


def number_in(name: str) -> int | None:
    """The number of the image that a name stands for, without what an estimator adds; None where there is none."""
    number = number_of(_PERSON.sub("", name))
    return number_of(name) if number is None else number


def frame_of(name: str, frames: Sequence[str]) -> int | None:
    """The index of the frame that a name, without suffix, stands for; None where it stands for none or for several.

    Tried in this order: the same name; the same but for what an estimator adds at its end (``000743_0``); the same
    number at the end (``frame_0000000743`` is ``000743``).
    """
    image = _PERSON.sub("", name)
    for candidate in (name, image):
        if candidate in frames:
            return frames.index(candidate)
    number = number_in(name)
    same = [n for n, frame in enumerate(frames) if number is not None and number_of(frame) == number]
    return same[0] if len(same) == 1 else None
