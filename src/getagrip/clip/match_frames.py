"""Match files of other programs to a clip's frames by their names.

Estimators often number their inputs from 0, whatever the video's first frame. Files and frames may then share some
numbers by chance, and files would be matched to wrong frames: ``check_frame_numbers`` asks the user.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path, PurePosixPath

from getagrip.errors import InputError, UsageError
from getagrip.io import files

_TRAILING_NUMBER = re.compile(r"(\d{1,12})$")
_PERSON_SUFFIX = re.compile(r"_\d{1,2}$|_\d{1,2}_3dkeypoints$|_prediction_result$")
"""Suffixes added by estimators: HaMeR's number of a person, FrankMocap's two words."""
_OBJECT_SUFFIX = re.compile(
    r"(?<=\d{3})[-_.](?:(?:object|obj|mask|instance|inst|segment)s?[-_]?(?:0|[1-9]\d{0,2})?"
    r"|(?:class|label|tag)[-_][a-z]\w*)$",
    re.IGNORECASE,
)
"""Suffixes of images of single objects, such as RectLabel's ``000001_object0``."""
_LABEL_STUDIO_TASK = re.compile(r"(.*task-\d+)-annotation-\d+(?:-by-\d+)?-tag-(.+)-\d+$")
"""Label Studio's images: the number of the task (one image), and a label."""
_ROBOFLOW_SUFFIX = re.compile(r"_(?:jpe?g|png|webp|bmp|tiff?)\.rf\.[0-9A-Za-z]+$", re.IGNORECASE)
_UUID_SUFFIX = re.compile(r"(?:^|[-_. ])[0-9a-f]{8}(?:-?[0-9a-f]{4}){3}-?[0-9a-f]{12}$", re.IGNORECASE)
_LAST_NAME_PART = re.compile(r"(?:^|[-_. ])([0-9A-Za-z]+)$")
_SIZE_OR_TIME = re.compile(r"\d+x\d+|\d{8}T\d{4,}Z?")
_HASH_OR_DATE = re.compile(r"(?=.{8})(?:[a-f]+\d+|[1-9]\d+)", re.IGNORECASE)
"""A hash or date, if a number precedes it; else a word with the frame's number, or a number."""
_HEX_DIGITS, _MIN_HASH_LENGTH = {*"0123456789abcdef"}, 6
_MIN_DATE_NUMBER = 10_000_000
"""Number from which on a name may have a date, a time, or a hash without letters."""
_MAX_NAME_LENGTH = 255
MAX_NAMES_IN_ERROR = 12


def stem_of(file_name: str) -> str:
    """Strip folders and suffix from a file's name."""
    name = file_name.replace("\\", "/").rsplit("/", maxsplit=1)[-1]
    return name.rpartition(".")[0] or name


def number_of(name: str) -> int | None:
    """Return the number at the end of a name; None without one."""
    found = _TRAILING_NUMBER.search(name)
    return int(found[1]) if found else None


def number_in(name: str) -> int | None:
    """Return the number of an image by its name; None without one.

    Additions behind the number are ignored: a person's number by estimators, a hash, a size or a date.
    """
    name = _OBJECT_SUFFIX.sub("", _LABEL_STUDIO_TASK.sub(r"\1", strip_name_codes(name)))
    number = number_of(_PERSON_SUFFIX.sub("", name))
    return number_of(name) if number is None else number


def pattern_of(name: str) -> str:
    """Return the pattern of an image's set, which has one image per frame: ``rgb_*``, ``*_object0``."""
    return _image_set_of(name)[0]


def _image_set_of(name: str) -> tuple[str, int | None]:
    """Return the pattern of an image's set, and the image's number in it; dates and times before it become ``*``."""
    path = PurePosixPath(name.replace("\\", "/"))
    if task := _LABEL_STUDIO_TASK.match(path.stem):
        return str(path.with_name(f"*-tag-{task[2]}-*")), number_in(path.stem)
    stem = strip_name_codes(path.stem)
    bare = _OBJECT_SUFFIX.sub("", stem)
    bare = _PERSON_SUFFIX.sub("", bare) if number_of(_PERSON_SUFFIX.sub("", bare)) is not None else bare
    found = list(re.finditer(r"\d{1,12}", bare))
    begin, end = found[-1].span() if found else (0, len(stem))
    pattern = re.sub(r"\d{4,}|\d+(?=\.\*)", "*", f"{stem[:begin]}*{stem[end:]}")
    return str(path.with_name(pattern)), int(found[-1][0]) if found else None


def single_image_set(folder: Path, paths: Sequence[Path], images: str = "", option: str = "") -> list[Path]:
    """Return the images of a folder that match ``images``, one for each number.

    ``option`` is the command line's option for ``images``. Raises ``InputError`` for several images of one number, such
    as colour and depth side by side, and ``UsageError`` if none matches.
    """
    chosen = [paths[row] for row in matching_names([path.name for path in paths], images)]
    if paths and not chosen:
        raise UsageError(f"{option} must be a pattern of names in {folder}, as {files.printable(paths[0].name)} is one")
    numbered: dict[int, dict[str, Path]] = {}
    for path in chosen:
        pattern, number = _image_set_of(path.name)
        if number is not None and not images:
            numbered.setdefault(number, {}).setdefault(pattern, path)
    both = next((list(of.values())[:2] for of in numbered.values() if len(of) > 1), None)
    stems: dict[str, Path] = {}
    for path in chosen if both is None else ():
        if stems.setdefault(path.stem, path) != path:
            both = [stems[path.stem], path]
            break
    if both is not None:
        sets = suggest_image_filters([path.name for path in both])
        options = " or ".join(f"{option} {files.shorten_value(one)}" for one in sets)
        choice = f"{options} chooses" if option else "a folder of its own for each set"
        got = f"several images of one frame, {' and '.join(files.printable(path.name) for path in both)}"
        raise InputError(folder, "", got, f"one set of images; {choice}")
    return chosen


def strip_name_codes(name: str) -> str:
    """Strip hashes, sizes and dates at a name's end: ``000001_jpg.rf.9f86d081`` is ``000001``."""
    if len(name) > _MAX_NAME_LENGTH:
        return name
    name = _UUID_SUFFIX.sub("", _ROBOFLOW_SUFFIX.sub("", name))
    while (last := _LAST_NAME_PART.search(name)) and _is_code(last[1], name[: last.start()]):
        name = name[: last.start()]
    return name


def _is_code(part: str, before: str) -> bool:
    """Return whether a part of a name, after ``before``, is a hash, a size, a date or a time."""
    low, previous = part.lower(), _LAST_NAME_PART.search(before)
    if len(low) >= _MIN_HASH_LENGTH and {*low} <= _HEX_DIGITS and re.search(r"\d[a-f]", low):
        return True
    if _SIZE_OR_TIME.fullmatch(part):
        return True
    return _HASH_OR_DATE.fullmatch(part) is not None and previous is not None and previous[1].isdigit()


def frame_of(name: str, frames: Sequence[str]) -> int | None:
    """Return the index of the frame that a file's name, without suffix, matches; None for no frame or several.

    Tried in this order: the same name; the same without additions at its end (``000743_0``, a hash); the same number
    at the end (``frame_0000000743`` is ``000743``), a date only if frames are numbered by dates.
    """
    return _find_frame(name, _index_frames(tuple(frames)))


def frames_of(names: Iterable[str], frames: Sequence[str]) -> Iterator[int | None]:
    """Yield ``frame_of`` for many names."""
    places = _index_frames(tuple(frames))
    return (_find_frame(name, places) for name in names)


def _find_frame(name: str, places: tuple[dict[str, int], dict[int, list[int]]]) -> int | None:
    by_name, by_number = places
    for candidate in (name, _PERSON_SUFFIX.sub("", name), strip_name_codes(name), _OBJECT_SUFFIX.sub("", name)):
        if candidate in by_name:
            return by_name[candidate]
    date = number_of(name)
    for number in (number_in(name), date if date is not None and date >= _MIN_DATE_NUMBER else None):
        same = [] if number is None else by_number.get(number, [])
        if len(same) == 1:
            return same[0]
    return None


def rows_of_frames(
    names: Sequence[str], frames: Sequence[str], source: Path, what: str, images: str = "", option: str = ""
) -> dict[int, int]:
    """Match frames to rows by their names: the row of each frame's file, image or pose, at most one.

    ``what`` names a row in errors. ``images`` selects names by a folder or a pattern, and ``option`` is its option on
    the command line. Raises ``UsageError`` if no name matches ``images``, and ``InputError`` for two rows of one frame.
    """
    chosen = matching_names(names, images)
    if names and not chosen:
        some = f"a folder of {source}'s images or a pattern of their names, as {files.printable(names[0])}"
        raise UsageError(f"{option or '--images'} must be {some} (got {images!r})")
    found: dict[int, list[int]] = {}
    for row, n in zip(chosen, frames_of((stem_of(names[row]) for row in chosen), frames), strict=True):
        if n is not None:
            found.setdefault(n, []).append(row)
    several = next((n for n in sorted(found) if len(found[n]) > 1), None)
    if several is not None:
        first, second = (files.printable(names[row]) for row in found[several][:2])
        got = f"a second {what} of frame {files.printable(frames[several])}, {second} beside {first}"
        sets = suggest_image_filters([names[row] for of_frame in found.values() for row in of_frame])
        choice = f"; {option} chooses: {' or '.join(map(files.printable, sets))}" if option and len(sets) > 1 else ""
        raise InputError(source, "", got, f"one{choice}")
    return {n: of_frame[0] for n, of_frame in found.items()}


def rows_in_order(
    count: int, frames: Sequence[str], source: Path, what: str, counted: bool, option: str = "--first"
) -> dict[int, int]:
    """Match frames to rows without names: of the clip's frames, or of a whole video.

    If the user has ``counted`` by an ``option``, frames' numbers are those of their rows, from 0. Raises ``InputError``
    for fewer rows than frames, and ``UsageError`` if the rows of the clip are unknown or missing.
    """
    got = f"{count} {what}s without names for {len(frames)} frames"
    if count < len(frames):
        raise InputError(source, "", got, f"one for each of the {len(frames)} frames, or names of their frames")
    if not counted and count > len(frames):
        which = f"{option} N, the number of the first frame's {what}, counted from 0"
        raise UsageError(f"{source}: {got}: missing {which}")
    if not counted:
        return {n: n for n in range(count)}
    rows = {n: int(number_of(frame) or 0) for n, frame in enumerate(frames)}
    if max(rows.values()) >= count:
        raise UsageError(
            f"{option} must be such that the clip's frames are among {count} {what}s of {source}, counted from 0 "
            f"(got {rows[0]}: the last frame's is number {rows[len(frames) - 1]})"
        )
    return rows


def check_unique_images(source: Path, names: Sequence[str], found: Sequence[int | None], frames: Sequence[str]) -> None:
    """Raise ``InputError`` for two images of one frame; an image may have several hands (``_PERSON_SUFFIX``)."""
    images: dict[int, tuple[str, str]] = {}
    for name, n in zip(names, found, strict=True):
        path = PurePosixPath(name.replace("\\", "/"))
        image = str(path.with_name(_PERSON_SUFFIX.sub("", path.stem or path.name)))
        if n is not None and (other := images.setdefault(n, (image, name)))[0] != image:
            both = f"{files.printable(name)} beside {files.printable(other[1])}"
            sets = suggest_image_filters([each for each, at in zip(names, found, strict=True) if at is not None])
            some = f"; give the files of {' or '.join(map(files.printable, sets))}" if sets else ""
            raise InputError(source, "", f"a second image of frame {files.printable(frames[n])}, {both}", f"one{some}")


def matching_names(names: Sequence[str], images: str) -> list[int]:
    """Return the indices of names in the folder ``images``, or matching it as a pattern; all if it is empty.

    A set's own pattern, such as ``*`` of ``000001`` beside ``000001_thumb``, selects that set alone.
    """
    own = [row for row, name in enumerate(names) if images and pattern_of(name) == images]
    return own or [row for row, name in enumerate(names) if _matches_pattern(name, images)]


def _matches_pattern(name: str, images: str) -> bool:
    path, folder = PurePosixPath(name.replace("\\", "/")), images.strip("/")
    inside = f"/{folder}/" in f"/{path.parent}/"
    return not folder or inside or any(fnmatchcase(one, images) for one in (str(path), path.name, path.stem))


def suggest_image_filters(names: Sequence[str]) -> list[str]:
    """List folders, suffixes or patterns of names, whichever differ between images of one frame; the first few."""
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    folders, suffixes = {str(path.parent) for path in paths}, {f"*{path.suffix}" for path in paths}
    sets = (folders, suffixes, {pattern_of(name) for name in names})
    return next((sorted(each)[:MAX_NAMES_IN_ERROR] for each in sets if len(each) > 1), [])


@lru_cache(maxsize=8)
def _index_frames(frames: tuple[str, ...]) -> tuple[dict[str, int], dict[int, list[int]]]:
    """Index frames by their names and by their numbers."""
    by_number: dict[int, list[int]] = {}
    for n, frame in enumerate(frames):
        number = number_of(strip_name_codes(frame))
        if number is not None:
            by_number.setdefault(number, []).append(n)
    return {frame: n for n, frame in reversed(list(enumerate(frames)))}, by_number


def renumber_frames(frames: Sequence[str], first: int, option: str) -> tuple[str, ...]:
    """Return frame names numbered from ``first``. Raises ``UsageError`` for names without numbers, or ``first`` < 0."""
    if first < 0:
        raise UsageError(f"{option} must be 0 or more (got {first})")
    numbers = [number_of(name) for name in frames]
    known = [number for number in numbers if number is not None]
    if len(known) < len(frames):
        raise UsageError(f"{option} cannot be used: the clip's frames have no numbers")
    return tuple(f"{number - known[0] + first:06d}" for number in known)


def has_number_offset(frames: Sequence[str], names: Iterable[str]) -> bool:
    """Return whether files seem to be numbered from another start than frames.

    Either the files have a number 0 and the frames do not; or half to all as many numbers as frames begin and end
    earlier, or begin and end later, and only some of them are frames'.
    """
    of_frames, value = _known_numbers(frames, number_of), _known_numbers(names, number_in)
    if len(of_frames) < len(frames) or not value:
        return False
    earlier = min(value) < min(of_frames) and max(value) < max(of_frames)
    later = min(value) > min(of_frames) and max(value) > max(of_frames)
    from_zero = 0 in value and 0 not in of_frames
    about_as_many = len(of_frames) <= 2 * len(value) <= 2 * len(of_frames)
    return from_zero or ((earlier or later) and bool(value & of_frames) and about_as_many)


def check_frame_numbers(frames: Sequence[str], names: Iterable[str], source: object, what: str, option: str) -> None:
    """Raise ``UsageError`` for files with another start (``has_number_offset``) that the user has not stated.

    ``what`` names a file in errors; ``option`` states the number of the first frame's file, and is empty if it was
    used.
    """
    names = list(names)
    if not option or not has_number_offset(frames, names):
        return
    of_frames, value = _known_numbers(frames, number_of), _known_numbers(names, number_in)
    first, used = number_of(frames[0]) or 0, "segmented" if what == "mask" else "its input"
    choices = {min(value): f"if the clip's images were {used}"}
    if 0 in value and first > 1:
        choices[first - 1] = "if the whole video was"
    choices |= {first: "if its numbers are the frames' numbers"}
    each = ", ".join(f"{option} {start} {when}" for start, when in choices.items())
    found = ", ".join(str(len({n - first + start for n in of_frames} & value)) for start in choices)
    raise UsageError(
        f"missing {option}: the number of the {what} of frame {files.printable(frames[0])}: in {source} they "
        f"are numbered {min(value)} to {max(value)}, the clip's frames {min(of_frames)} to {max(of_frames)}. "
        f"{each}: then {found} of {len(frames)} frames have one"
    )


def _known_numbers(names: Iterable[str], number: Callable[[str], int | None]) -> set[int]:
    return {known for name in names if (known := number(name)) is not None}
