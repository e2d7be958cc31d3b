"""Segments of a timeline: the state of a clip's object in each interval of frames, from table to hand and back.

In a stable grasp (Eq. 2) the object turns in the hand, nearly about one axis. Before and after it, the object is static
in the world, moves in an unstable contact with a hand, or moves freely. Frames outside all segments are unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.io import files

State = Literal["static", "contact", "grasp", "free"]
"""Static in the world; in unstable contact with a hand; in a stable grasp; moving without a hand."""
Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = get_args(Side)
STATES: tuple[State, ...] = get_args(State)
SEGMENT_KEYS = ("state", "first", "last", "side")
"""Keys of a segment in ``clip.json``."""
SEGMENT_FORMAT = '{"state": "static", "first": "000001", "last": "000030"}, and "side" of a grasp'


def opposite_side(side: Side) -> Side:
    """Return the side of a person's other hand."""
    return "left" if side == "right" else "right"


@dataclass(frozen=True)
class Segment:
    """An interval of a clip's frames with one state of the object.

    Attributes:
        state: the object's state.
        first: the first frame, counted from 0 in the clip.
        last: the last frame, included.
        side: the hand that touches the object, ``left`` or ``right``: required for a grasp, optional for an unstable
            contact, None in the other states.
    """

    state: State
    first: int
    last: int
    side: Side | None = None

    def __post_init__(self) -> None:
        if self.state not in STATES:
            raise UsageError(f"unknown Segment.state {self.state!r}; choose from {', '.join(STATES)}")
        if not 0 <= self.first <= self.last:
            got = f"frames {self.first} to {self.last}"
            raise UsageError(f"Segment.first must be 0 or more, and not after Segment.last (got {got})")
        wrong = expected_side(self.state, self.side)
        if wrong:
            raise UsageError(f"Segment.side must be {wrong} (got {self.side!r})")

    def __len__(self) -> int:
        return self.last + 1 - self.first

    @property
    def rows(self) -> Int[ndarray, "n"]:
        """Indices of the frames."""
        return np.arange(self.first, self.last + 1)


def expected_side(state: State, side: object) -> str | None:
    """Describe the expected side of a segment; None if ``side`` is valid."""
    if state in ("static", "free"):
        return None if side is None else f"none: no hand moves an object that is {state}"
    if side is None and state == "contact":
        return None
    return None if side in ("left", "right") else "left or right, of a grasp"


def check_segments(segments: Sequence[Segment], frames: int, has_world: bool) -> None:
    """Raise ``UsageError`` for segments that overlap, are unordered or outside the clip, or static without a world."""
    for n, segment in enumerate(segments):
        got = f"frames {segment.first} to {segment.last}"
        if segment.last >= frames:
            raise UsageError(f"Clip.segments[{n}] must be in frames 0 to {frames - 1} (got {got})")
        if n and segment.first <= segments[n - 1].last:
            raise UsageError(f"Clip.segments[{n}] must start after frame {segments[n - 1].last} (got {got})")
        if segment.state == "static" and not has_world:
            raise UsageError(f"Clip.segments[{n}] cannot be static without Clip.world")


def at_frames(segments: Sequence[Segment], index: Int[ndarray, "n"]) -> tuple[Segment, ...]:
    """Return the segments of a clip at some of its frames; none if these are not in the clip's order."""
    if np.any(np.diff(index) <= 0):
        return ()
    bounds = [np.searchsorted(index, [s.first, s.last + 1]) for s in segments]
    pairs = zip(segments, bounds, strict=True)
    return tuple(replace(s, first=int(first), last=int(end) - 1) for s, (first, end) in pairs if end > first)


def read_segments(path: Path, value: object, frames: Sequence[str], has_world: bool) -> tuple[Segment, ...]:
    """Parse the ``segments`` of a ``clip.json``, given by frame names. Raises ``InputError``."""
    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        raise InputError(path, "segments", files.shorten_value(value), f"a list of {SEGMENT_FORMAT}")
    row_of = {name: row for row, name in enumerate(frames)}
    out: list[Segment] = []
    for n, fields in enumerate(value):
        segment = _read_segment(path, f"segments[{n}]", fields, row_of)
        if out and segment.first <= out[-1].last:
            before = f"a frame after {files.shorten_value(frames[out[-1].last])}, where the segment before it ends"
            raise InputError(path, f"segments[{n}].first", files.shorten_value(fields["first"]), before)
        if segment.state == "static" and not has_world:
            expected = "no static segment without camera.T_world_cam, by which it stands still"
            raise InputError(path, f"segments[{n}].state", "static", expected)
        out.append(segment)
    return tuple(out)


def _read_segment(path: Path, key: str, fields: files.Json, row_of: dict[str, int]) -> Segment:
    unknown = next((name for name in fields if name not in SEGMENT_KEYS), None)
    if unknown is not None:
        expected = f"one of {', '.join(SEGMENT_KEYS)}"
        raise InputError(path, f"{key}.{files.printable(unknown)}", "an unknown key", expected)
    missing = next((name for name in SEGMENT_KEYS[:3] if name not in fields), None)
    if missing is not None:
        raise InputError(path, f"{key}.{missing}", "no such key", SEGMENT_FORMAT)
    state, side = fields["state"], fields.get("side")
    if state not in STATES:
        raise InputError(path, f"{key}.state", files.shorten_value(state), f"one of {', '.join(STATES)}")
    wrong = expected_side(state, side)
    if wrong:
        raise InputError(path, f"{key}.side", files.shorten_value(side), wrong)
    rows = []
    for end in ("first", "last"):
        name = fields[end]
        if not isinstance(name, str) or name not in row_of:
            raise InputError(path, f"{key}.{end}", files.shorten_value(name), "the name of one of the clip's frames")
        rows.append(row_of[name])
    if rows[0] > rows[1]:
        got = f"{files.shorten_value(fields['last'])} before {files.shorten_value(fields['first'])}"
        raise InputError(path, f"{key}.last", got, "the first frame of the segment or a later one")
    return Segment(state, rows[0], rows[1], side)


def segment_fields(segments: Sequence[Segment], frames: Sequence[str]) -> list[dict[str, str]]:
    """Return the content of ``segments`` in ``clip.json``."""
    sides = [{} if s.side is None else {"side": s.side} for s in segments]
    ends = [{"state": s.state, "first": frames[s.first], "last": frames[s.last]} for s in segments]
    return [{**fields, **side} for fields, side in zip(ends, sides, strict=True)]
