"""Which frame of a clip a file from another program belongs to, by its name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

_NUMBER = re.compile(r"(\d{1,12})$")
_PERSON = re.compile(r"_\d{1,2}$|_\d{1,2}_3dkeypoints$|_prediction_result$")
"""What estimators add to an image's name: HaMeR a person's number, FrankMocap two words."""
_ROBOFLOW = re.compile(r"_(?:jpe?g|png|webp|bmp|tiff?)\.rf\.[0-9A-Za-z]+$", re.IGNORECASE)
_UUID = re.compile(r"(?:^|[-_. ])[0-9a-f]{8}(?:-?[0-9a-f]{4}){3}-?[0-9a-f]{12}$", re.IGNORECASE)
_LAST = re.compile(r"(?:^|[-_. ])([0-9A-Za-z]+)$")
_SIZE_OR_TIME = re.compile(r"\d+x\d+|\d{8}T\d{4,}Z?")
_HASH_OR_DATE = re.compile(r"(?=.{8})(?:[a-f]+\d+|[1-9]\d+)", re.IGNORECASE)
"""May also be a word with the frame's number, or a number: what it is shows in what is before it."""
_HEXADECIMAL, _SHORTEST_HASH = {*"0123456789abcdef"}, 6
_DATES = 10_000_000
"""Numbers from here on may be dates, times, or hashes without a letter."""
_LONGEST = 255
"""Letters of a file's name."""


def stem_of(file_name: str) -> str:
    """A file's name without folders and suffix."""
    name = file_name.replace("\\", "/").rsplit("/", maxsplit=1)[-1]
    return name.rpartition(".")[0] or name


def number_of(name: str) -> int | None:
    """The number at the end of a name; None where there is none."""
    found = _NUMBER.search(name)
    return int(found[1]) if found else None


def number_in(name: str) -> int | None:
    """The number of the image that a name stands for; None where there is none.

    Without what is added behind it: a person by estimators, a hash, a size or a date by other programs.
    """
    name = without_codes(name)
    number = number_of(_PERSON.sub("", name))
    return number_of(name) if number is None else number


def without_codes(name: str) -> str:
    """A name without the hashes, sizes and dates at its end: ``000001_jpg.rf.9f86d081`` is ``000001``."""
    if len(name) > _LONGEST:
        return name
    name = _UUID.sub("", _ROBOFLOW.sub("", name))
    while (last := _LAST.search(name)) and _is_code(last[1], name[: last.start()]):
        name = name[: last.start()]
    return name


def _is_code(part: str, before: str) -> bool:
    """Whether a part of a name is no word and no number of a frame."""
    low, behind = part.lower(), _LAST.search(before)
    if len(low) >= _SHORTEST_HASH and {*low} <= _HEXADECIMAL and re.search(r"\d[a-f]", low):
        return True
    if _SIZE_OR_TIME.fullmatch(part):
        return True
    return _HASH_OR_DATE.fullmatch(part) is not None and behind is not None and behind[1].isdigit()


def frame_of(name: str, frames: Sequence[str]) -> int | None:
    """The index of the frame that a name, without suffix, stands for; None where it stands for none or for several.

    Tried in this order: the same name; the same but for what is added at its end (``000743_0``, a hash); the same
    number at the end (``frame_0000000743`` is ``000743``), a date only where frames are numbered by dates.
    """
    return _frame_at(name, _places(tuple(frames)))


def frames_of(names: Iterable[str], frames: Sequence[str]) -> Iterator[int | None]:
    """``frame_of`` of many names."""
    places = _places(tuple(frames))
    return (_frame_at(name, places) for name in names)


def _frame_at(name: str, places: tuple[dict[str, int], dict[int, list[int]]]) -> int | None:
    by_name, by_number = places
    for candidate in (name, _PERSON.sub("", name), without_codes(name)):
        if candidate in by_name:
            return by_name[candidate]
    date = number_of(name)
    for number in (number_in(name), date if date is not None and date >= _DATES else None):
        same = [] if number is None else by_number.get(number, [])
        if len(same) == 1:
            return same[0]
    return None


@lru_cache(maxsize=8)
def _places(frames: tuple[str, ...]) -> tuple[dict[str, int], dict[int, list[int]]]:
    """Where frames are, by their names and by their numbers."""
    by_number: dict[int, list[int]] = {}
    for n, frame in enumerate(frames):
        number = number_of(without_codes(frame))
        if number is not None:
            by_number.setdefault(number, []).append(n)
    return {frame: n for n, frame in reversed(list(enumerate(frames)))}, by_number
