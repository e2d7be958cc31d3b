"""Whether the numbers of another program's files are those of a clip's frames, or are counted from another start.

Estimators often count what they were given, whichever frame of a video that began with. Files and frames may then
have some numbers in common, by luck, and each file would be taken for another frame's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from getagrip.clip.naming import number_in, number_of
from getagrip.errors import UsageError
from getagrip.io import files


def renumbered(frames: Sequence[str], first: int, option: str) -> tuple[str, ...]:
    """The names of frames where the first one has another number. Raises ``UsageError`` where they have none."""
    numbers = [number_of(name) for name in frames]
    known = [number for number in numbers if number is not None]
    if len(known) < len(frames):
        raise UsageError(f"{option} cannot be used: the clip's frames have no numbers")
    return tuple(f"{number - known[0] + first:06d}" for number in known)


def counted_elsewhere(frames: Sequence[str], names: Iterable[str]) -> bool:
    """Whether files seem to be counted from another start than frames.

    That is where they have a number 0 and frames have not, and where only some of their numbers are frames': where
    about as many numbers as frames, from half of these to all, begin and end earlier, or begin and end later.
    """
    of_frames, given = _numbers(frames, number_of), _numbers(names, number_in)
    if len(of_frames) < len(frames) or not given:
        return False
    earlier = min(given) < min(of_frames) and max(given) < max(of_frames)
    later = min(given) > min(of_frames) and max(given) > max(of_frames)
    from_zero = 0 in given and 0 not in of_frames
    about_as_many = len(of_frames) <= 2 * len(given) <= 2 * len(of_frames)
    return from_zero or ((earlier or later) and bool(given & of_frames) and about_as_many)


def check_numbers(frames: Sequence[str], names: Iterable[str], source: object, what: str, option: str) -> None:
    """Raise ``UsageError`` where files are ``counted_elsewhere`` and nobody has said how they match.

    ``what`` each of them is, in a word; ``option`` states the number of the first frame's, and is empty where it was
    used.
    """
    names = list(names)
    if not option or not counted_elsewhere(frames, names):
        return
    of_frames, given = _numbers(frames, number_of), _numbers(names, number_in)
    first, used = number_of(frames[0]) or 0, "segmented" if what == "mask" else "its input"
    choices = {min(given): f"if the clip's images were {used}"}
    if 0 in given and first > 1:
        choices[first - 1] = "if the whole video was"
    choices |= {first: "if its numbers are the frames' numbers"}
    each = ", ".join(f"{option} {start} {when}" for start, when in choices.items())
    found = ", ".join(str(len({n - first + start for n in of_frames} & given)) for start in choices)
    raise UsageError(
        f"missing {option}: the number of the {what} of frame {files.plain(frames[0])}: in {source} they "
        f"are numbered {min(given)} to {max(given)}, the clip's frames {min(of_frames)} to {max(of_frames)}. "
        f"{each}: then {found} of {len(frames)} frames have one"
    )


def _numbers(names: Iterable[str], number: Callable[[str], int | None]) -> set[int]:
    return {known for name in names if (known := number(name)) is not None}
