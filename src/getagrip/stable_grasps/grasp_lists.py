"""Lists of stable grasps: found by this package, made by others, or marked by hand.

The JSON of docs/formats.md is written:

    {"version": 1, "cut": {...}, "grasps": [{"sequence": "s01--box_use_01--box--left", "side": "left", "object": "box",
                                             "first": "00033", "last": "00073", "duration": 1.37}, ...]}

A CSV of these columns, bare lists as ``annotate`` exports them, and the lists of the paper's authors can be read, too.

The authors publish timelines of HOT3D and EPIC (``*_hit.json``):

    [{"seq_name": "P0010_b152143e", "cat": "cellphone", "total_end": 3594,
      "segments": [{"st": 363, "ed": 383, "side": "left", "ref": "inhand"}, ...]}, ...]

``ref`` is ``inhand`` (a stable grasp by their weakest test, ``consecutive``), ``scene_static`` or ``scene_dynamic``.
``st`` and ``ed`` are both included; a segment may begin in the last frame of the one before. Some segments end before
they start. Their code (https://github.com/zhifanzhu/objects-along-hit) writes and reads the lists in this way.

In HOT3D's lists, numbers count the images of the RGB camera (on a Quest 3, the first large camera) from 0, and
``total_end`` is their number. EPIC's lists have ``vid`` for ``seq_name``, EPIC's own frame numbers, and additionally
``timeline_name``, ``main_side``, and ``mp4_name``, by which EPIC-Grasps' table identifies the object.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.clip.timeline import State
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io import files
from getagrip.io.files import Json, is_portable_name, printable, shorten_value
from getagrip.io.terminal import format_count

STATE_OF_REF: dict[str, State] = {"inhand": "grasp", "scene_static": "static", "scene_dynamic": "contact"}
"""State of a segment with each ``ref``."""
SIDE_OF_NAME: dict[object, Side | None] = {"left": "left", "right": "right", None: None}
MAX_TIMELINE_SEGMENTS = 100_000
"""Maximum number of segments of a timeline; all of HOT3D has 3288."""
GRASP_LIST_VERSION = 1
GRASP_LIST_FILE = "grasps.json"
"""Name of the list that is stored beside the clips cut by it."""
MAX_GRASP_LIST_BYTES = 64 * 2**20
"""Maximum size of a list [bytes]."""
MAX_GRASP_S = 86400.0
"""Maximum duration of a grasp [s]."""
MAX_FRAME_NUMBER = 10_000_000
CLIP_NAME_SEPARATOR = "--"
"""Separator of subject, sequence, object and side in a clip's name."""
EXPECTED_GRASP_LIST = "a list of grasps, CSV or JSON"
REQUIRED_GRASP_COLUMNS = ("sequence", "side", "object")
"""Columns that every table must have."""


@dataclass(frozen=True)
class ListedTimeline:
    """A timeline of a list: an interaction with an object; its segments count frames as the list does."""

    sequence: str
    category: str
    segments: tuple[Segment, ...]

    @property
    def grasped(self) -> tuple[Segment, ...]:
        """The segments that are stable grasps."""
        return tuple(segment for segment in self.segments if segment.state == "grasp")


def read_hot3d_timelines(
    path: Path, content: Sequence[Json], note: Callable[[str], None]
) -> tuple[tuple[ListedTimeline, ...], dict[str, int]]:
    """Read the authors' HOT3D timelines, and the number of frames of each recording.

    Segments that end before they start are skipped, and reported by ``note``. Raises ``InputError``.
    """
    found = []
    frames: dict[str, int] = {}
    for n, timeline in enumerate(content):
        name = timeline.get("seq_name")
        if not isinstance(name, str) or not is_portable_name(name):
            raise InputError(path, f"[{n}].seq_name", shorten_value(name), "a recording, as P0010_b152143e")
        length = parse_frame_number(path, f"[{n}].total_end", timeline.get("total_end"))
        if frames.setdefault(name, length) != length:
            raise InputError(path, f"[{n}].total_end", str(length), f"{frames[name]}, as before for {name}")
        category = timeline.get("cat")
        if not isinstance(category, str):
            raise InputError(path, f"[{n}].cat", shorten_value(category), "the name of an object")
        segments = parse_timeline_segments(path, f"[{n}].segments", timeline.get("segments"))
        found.append(ListedTimeline(name, category, segments))
    report_backwards(path, content, note)
    return tuple(found), frames


def parse_timeline_segments(path: Path, key: str, value: object) -> tuple[Segment, ...]:
    """Parse the segments of a timeline, without those that end before they start. Raises ``InputError``."""
    if not isinstance(value, list) or not all(isinstance(segment, dict) for segment in value):
        raise InputError(path, key, shorten_value(value), "a list of objects")
    if len(value) > MAX_TIMELINE_SEGMENTS:
        raise InputError(path, key, f"{len(value)} segments", f"at most {MAX_TIMELINE_SEGMENTS}")
    out = []
    for k, segment in enumerate(value):
        first, last = (parse_frame_number(path, f"{key}[{k}].{end}", segment.get(end)) for end in ("st", "ed"))
        ref, side = segment.get("ref"), segment.get("side")
        if not isinstance(ref, str) or ref not in STATE_OF_REF:
            raise InputError(path, f"{key}[{k}].ref", shorten_value(ref), f"one of {', '.join(STATE_OF_REF)}")
        state = STATE_OF_REF[ref]
        known = (side is None or isinstance(side, str)) and side in SIDE_OF_NAME
        if not known or (side is None and state == "grasp"):
            raise InputError(path, f"{key}[{k}].side", shorten_value(side), "left or right")
        if first <= last:
            out.append(Segment(state, first, last, None if state == "static" else SIDE_OF_NAME[side]))
    return tuple(out)


def report_backwards(path: Path, content: Sequence[Json], note: Callable[[str], None]) -> None:
    """Report by ``note`` the number of segments that end before they start; ``content`` is valid."""
    backwards = [s["ref"] for timeline in content for s in timeline["segments"] if s["ed"] < s["st"]]
    if backwards:
        grasps = format_count(count := backwards.count("inhand"), "grasp")
        others = format_count(len(backwards) - count, "other segment")
        note(f"{path.name}: {grasps} and {others} end before they start: skipped")


def parse_frame_number(path: Path, key: str, value: object) -> int:
    """Parse the number of a frame. Raises ``InputError``."""
    if type(value) is not int or not 0 <= value <= MAX_FRAME_NUMBER:
        raise InputError(path, key, shorten_value(value), f"a whole number from 0 to {MAX_FRAME_NUMBER}")
    return value


@dataclass(frozen=True)
class ListedGrasp:
    """A grasp of a list, from the first to the last frame, both included."""

    sequence: str
    """Name of a clip, or the beginning of names: see ``is_of``."""
    side: Side
    object: str
    """Category of the object."""
    first: str | int
    """Name of the first frame; or its number, counted from 0 over the frames of the sequence."""
    last: str | int
    """Name or number of the last frame."""
    duration: float | None = None
    """Duration [s]; None: unknown."""

    def is_of(self, name: str, side: Side, category: str) -> bool:
        """Return whether a clip or track has the grasp's hand and object, and a name that begins with its sequence.

        The sequence ends at a ``--``: the clip ``s01--box_use_01--box--left--2`` has the sequence ``s01--box_use_01``.
        ``/`` or ``_`` may separate the parts as well, as in ``s01/box_use_01``.
        """
        if (self.side, self.object) != (side, category):
            return False
        parts = name.split(CLIP_NAME_SEPARATOR)
        begins = [parts[:n] for n in range(min(2, len(parts)), len(parts) + 1)]
        return self.sequence in {sep.join(begin) for begin in begins for sep in (CLIP_NAME_SEPARATOR, "/", "_")}

    def positions(self, frames: Sequence[str], origin: int | None = None) -> Int[ndarray, "n"]:
        """Return the indices of the ordered, named frames that belong to the grasp.

        Names that are numbers are compared as numbers. ``origin`` is the number in the name of the sequence's first
        frame; None: numbers count the frames passed here.
        """
        at, low, high = np.arange(len(frames)), self.first, self.last
        numbered = all(name.isdecimal() for name in frames)
        if isinstance(low, str) and isinstance(high, str):
            if numbered and low.isdecimal() and high.isdecimal():
                at, low, high = np.array([int(name) for name in frames]), int(low), int(high)
            elif low in frames and high in frames:
                low, high = frames.index(low), frames.index(high)
            else:
                return at[:0]
        elif origin is not None and numbered:
            at = np.array([int(name) for name in frames]) - origin
        return np.flatnonzero((at >= int(low)) & (at <= int(high)))

    def row(self) -> files.Json:
        """Return the grasp's row of a list file."""
        named = isinstance(self.first, str)
        frames = {"first" if named else "start": self.first, "last" if named else "end": self.last}
        about = {"sequence": self.sequence, "side": self.side, "object": self.object}
        return about | frames | ({} if self.duration is None else {"duration": self.duration})


@dataclass(frozen=True)
class GraspList:
    """The content of a list file."""

    file: str
    sha256: str
    grasps: tuple[ListedGrasp, ...]
    lengths: Mapping[str, int] = field(default_factory=dict)
    """Number of frames of each recording, as far as the list has it."""
    timelines: tuple[ListedTimeline, ...] = ()
    """Timelines of the list; empty for lists of grasps."""

    def of(self, name: str, side: Side, category: str) -> list[ListedGrasp]:
        """Return the grasps of a clip or track."""
        return [grasp for grasp in self.grasps if grasp.is_of(name, side, category)]


def write_listed_grasps(path: Path, grasps: Sequence[ListedGrasp], cut: Mapping[str, object]) -> None:
    """Write a list; ``cut`` records the rules that made it."""
    with files.new_file(path) as part:
        files.write_json(part, {"version": GRASP_LIST_VERSION, "cut": cut, "grasps": [grasp.row() for grasp in grasps]})


def read_cut(path: Path) -> object:
    """Read the record of the rules that made a list of ``write_listed_grasps``. Raises ``InputError``."""
    content = files.read_json(path)
    _check_version(path, content)
    return content.get("cut")


def parse_contact_distance(path: Path, key: str, value: object) -> float:
    """Parse a contact distance [m]. Raises ``InputError``."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 0.05:
        raise InputError(path, key, shorten_value(value), "0 to 0.05 m")
    return float(value)


def read_listed_grasps(path: Path, note: Callable[[str], None] = lambda _: None) -> GraspList:
    """Read a list of grasps in any known format. Raises ``InputError`` with the row and the key."""
    content = files.read_bytes(path, MAX_GRASP_LIST_BYTES)
    checksum = sha256(content).hexdigest()
    if content.lstrip()[:1] not in (b"[", b"{"):
        heads, table = files.csv_rows(path, content, EXPECTED_GRASP_LIST)
        _check_heads(path, heads)
        return GraspList(path.name, checksum, tuple(parse_grasp_row(path, where, row) for where, row in table))
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:  # RecursionError: nested thousands deep
        raise InputError(path, "", f"invalid JSON ({error})", EXPECTED_GRASP_LIST) from error
    where = ""
    if isinstance(value, dict):
        _check_version(path, value)
        value, where = value.get("grasps"), "grasps"
    if not isinstance(value, list):
        raise InputError(path, where, shorten_value(value), "a list of grasps")
    for n, row in enumerate(value):
        if not isinstance(row, dict):
            expected = "a grasp: an object with sequence, side and object"
            raise InputError(path, f"{where}[{n}]", shorten_value(row), expected)
    if value and "segments" in value[0]:
        found, lengths = read_hot3d_timelines(path, value, note)
        grasps = tuple(
            ListedGrasp(one.sequence, cast(Side, s.side), one.category, s.first, s.last)
            for one in found
            for s in one.grasped
        )
        return GraspList(path.name, checksum, grasps, lengths, found)
    rows = [parse_grasp_row(path, f"{where}[{n}].", row) for n, row in enumerate(value)]
    return GraspList(path.name, checksum, tuple(rows))


def _check_version(path: Path, content: Mapping[str, object]) -> None:
    version = content.get("version")
    if type(version) is not int or version != GRASP_LIST_VERSION:
        raise InputError(path, "version", shorten_value(version), f"{GRASP_LIST_VERSION}")
    unknown = next((key for key in content if key not in ("version", "cut", "grasps")), None)
    if unknown is not None:
        raise InputError(path, printable(unknown), "an unknown key", "version, cut and grasps")


def _check_heads(path: Path, heads: Sequence[str]) -> None:
    for head in (*REQUIRED_GRASP_COLUMNS, *heads):
        if heads.count(head) != 1:
            got = f"{heads.count(head)} columns of this name among {shorten_value(heads)}"
            expected = f"one; those of a list are {', '.join(REQUIRED_GRASP_COLUMNS)}, ..."
            raise InputError(path, f"line 1, {printable(head)}", got, expected)


def parse_grasp_row(path: Path, where: str, row: files.Json) -> ListedGrasp:
    """Parse a row; ``where`` is the prefix of its keys in errors. Raises ``InputError``."""
    sequence = row.get("sequence", row.get("clip"))
    for key, value in (("sequence", sequence), ("object", row.get("object"))):
        if not (isinstance(value, str) and value.strip() and value.isprintable() and len(value) <= 400):
            raise InputError(path, f"{where}{key}", shorten_value(value), "a name")
    side = row.get("side")
    if side not in ("left", "right"):
        raise InputError(path, f"{where}side", shorten_value(side), "left or right")
    first, last = _parse_frame_range(path, where, row)
    duration = row.get("duration")
    if duration is not None and duration != "":
        duration = _parse_seconds(path, f"{where}duration", duration)
    return ListedGrasp(str(sequence), side, row["object"], first, last, duration or None)


def _parse_frame_range(path: Path, where: str, row: Mapping[str, object]) -> tuple[str, str] | tuple[int, int]:
    """Parse the names of the first and the last frame; without names, their numbers from 0."""
    if row.get("first") or row.get("last"):
        names = []
        for key in ("first", "last"):
            value = row.get(key)
            if not (isinstance(value, str) and files.is_portable_name(value)):
                raise InputError(path, f"{where}{key}", shorten_value(value), "the name of a frame, as a text")
            names.append(value)
        first, last = names
        if first.isdecimal() and last.isdecimal() and int(last) < int(first):
            raise InputError(path, f"{where}last", shorten_value(last), f"{first} or later")
        return first, last
    start, end = (_parse_listed_frame(path, f"{where}{key}", row.get(key)) for key in ("start", "end"))
    if end < start:
        raise InputError(path, f"{where}end", str(end), f"{start}, the start, or later")
    return start, end


def _parse_listed_frame(path: Path, key: str, value: object) -> int:
    number = value if type(value) is int else -1
    if isinstance(value, str) and value.isdecimal() and len(value) < 10:
        number = int(value)
    if not 0 <= number <= MAX_FRAME_NUMBER:
        expected = f"a frame counted from 0, up to {MAX_FRAME_NUMBER} (or first and last: frames' names)"
        raise InputError(path, key, shorten_value(value), expected)
    return number


def _parse_seconds(path: Path, key: str, value: object) -> float:
    try:
        seconds = math.nan if isinstance(value, bool) else float(cast(float, value))
    except (TypeError, ValueError, OverflowError):
        seconds = math.nan
    if not 0.0 < seconds <= MAX_GRASP_S:
        raise InputError(path, key, printable(str(value)), f"seconds, above 0, {MAX_GRASP_S:g} at most")
    return seconds
