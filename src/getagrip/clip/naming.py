"""Which frame of a clip a file from another program belongs to, by its name.

Estimators often count what they were given, whichever frame of a video that began with. Files and frames may then have
some numbers in common, by luck, and each file would be taken for another frame's: ``check_numbers`` asks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache

from getagrip.errors import UsageError
from getagrip.io import files

_NUMBER = re.compile(r"(\d{1,12})$")
_PERSON = re.compile(r"_\d{1,2}$|_\d{1,2}_3dkeypoints$|_prediction_result$")
"""Suffixes that estimators add to an image's name: HaMeR a person's number, FrankMocap two words."""
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
    """Return a file's name without folders and suffix."""
    name = file_name.replace("\\", "/").rsplit("/", maxsplit=1)[-1]
    return name.rpartition(".")[0] or name


def number_of(name: str) -> int | None:
    """Return the number at the end of a name; None where there is none."""
    found = _NUMBER.search(name)
    return int(found[1]) if found else None


def number_in(name: str) -> int | None:
    """Return the number of the image that a name stands for; None where there is none.

    Without what is added behind it: a person by estimators, a hash, a size or a date by other programs.
    """
    name = without_codes(name)
    number = number_of(_PERSON.sub("", name))
    return number_of(name) if number is None else number


def without_codes(name: str) -> str:
    """Strip the hashes, sizes and dates at a name's end: ``000001_jpg.rf.9f86d081`` is ``000001``."""
    if len(name) > _LONGEST:
        return name
    name = _UUID.sub("", _ROBOFLOW.sub("", name))
    while (last := _LAST.search(name)) and _is_code(last[1], name[: last.start()]):
        name = name[: last.start()]
    return name


def _is_code(part: str, before: str) -> bool:
    """Return whether a part of a name is no word and no number of a frame."""
    low, behind = part.lower(), _LAST.search(before)
    if len(low) >= _SHORTEST_HASH and {*low} <= _HEXADECIMAL and re.search(r"\d[a-f]", low):
        return True
    if _SIZE_OR_TIME.fullmatch(part):
        return True
    return _HASH_OR_DATE.fullmatch(part) is not None and behind is not None and behind[1].isdigit()


def frame_of(name: str, frames: Sequence[str]) -> int | None:
    """Return the index of the frame that a name, without suffix, stands for; None for no frame or several.

    Tried in this order: the same name; the same but for what is added at its end (``000743_0``, a hash); the same
    number at the end (``frame_0000000743`` is ``000743``), a date only where frames are numbered by dates.
    """
    return _frame_at(name, _places(tuple(frames)))


def frames_of(names: Iterable[str], frames: Sequence[str]) -> Iterator[int | None]:
    """Yield ``frame_of`` for many names."""
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
    """Index frames by their names and by their numbers."""
    by_number: dict[int, list[int]] = {}
    for n, frame in enumerate(frames):
        number = number_of(without_codes(frame))
        if number is not None:
            by_number.setdefault(number, []).append(n)
    return {frame: n for n, frame in reversed(list(enumerate(frames)))}, by_number


def renumbered(frames: Sequence[str], first: int, option: str) -> tuple[str, ...]:
    """Return the names of frames where the first one has another number.

    Raises ``UsageError`` where they have none, or where it would be below 0.
    """
    if first < 0:
        raise UsageError(f"{option} must be 0 or more (got {first})")
    numbers = [number_of(name) for name in frames]
    known = [number for number in numbers if number is not None]
    if len(known) < len(frames):
        raise UsageError(f"{option} cannot be used: the clip's frames have no numbers")
    return tuple(f"{number - known[0] + first:06d}" for number in known)


def counted_elsewhere(frames: Sequence[str], names: Iterable[str]) -> bool:
    """Return whether files seem to be counted from another start than frames.

    That is where they have a number 0 and frames have not, and where only some of their numbers are frames': where
    about as many numbers as frames, from half of these to all, begin and end earlier, or begin and end later.
    """
    of_frames, value = _numbers(frames, number_of), _numbers(names, number_in)
    if len(of_frames) < len(frames) or not value:
        return False
    earlier = min(value) < min(of_frames) and max(value) < max(of_frames)
    later = min(value) > min(of_frames) and max(value) > max(of_frames)
    from_zero = 0 in value and 0 not in of_frames
    about_as_many = len(of_frames) <= 2 * len(value) <= 2 * len(of_frames)
    return from_zero or ((earlier or later) and bool(value & of_frames) and about_as_many)


def check_numbers(frames: Sequence[str], names: Iterable[str], source: object, what: str, option: str) -> None:
    """Raise ``UsageError`` where files are ``counted_elsewhere`` and nobody has said how they match.

    ``what`` each of them is, in a word; ``option`` states the number of the first frame's, and is empty where it was
    used.
    """
    names = list(names)
    if not option or not counted_elsewhere(frames, names):
        return
    of_frames, value = _numbers(frames, number_of), _numbers(names, number_in)
    first, used = number_of(frames[0]) or 0, "segmented" if what == "mask" else "its input"
    choices = {min(value): f"if the clip's images were {used}"}
    if 0 in value and first > 1:
        choices[first - 1] = "if the whole video was"
    choices |= {first: "if its numbers are the frames' numbers"}
    each = ", ".join(f"{option} {start} {when}" for start, when in choices.items())
    found = ", ".join(str(len({n - first + start for n in of_frames} & value)) for start in choices)
    raise UsageError(
        f"missing {option}: the number of the {what} of frame {files.plain(frames[0])}: in {source} they "
        f"are numbered {min(value)} to {max(value)}, the clip's frames {min(of_frames)} to {max(of_frames)}. "
        f"{each}: then {found} of {len(frames)} frames have one"
    )


def _numbers(names: Iterable[str], number: Callable[[str], int | None]) -> set[int]:
    return {known for name in names if (known := number(name)) is not None}
