"""Lists of what hands do with HOT3D's objects, as the paper's authors published them (``hot3d_hit.json``).

    [{"seq_name": "P0010_b152143e", "cat": "cellphone", "total_end": 3594,
      "segments": [{"st": 363, "ed": 383, "side": "left", "ref": "inhand"}, ...]}, ...]

``ref`` is ``inhand`` (a stable grasp, by their weakest test: ``grasps``, ``consecutive``), ``scene_static`` or
``scene_dynamic``; only the first are read. ``st`` and ``ed`` are both included. They count, from 0, the images of the
RGB camera (of a Quest 3 the first large one), and ``total_end`` is their number: so their code
(https://github.com/zhifanzhu/objects-along-hit) makes and reads the list. Some of its segments end before they start.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from getagrip.datasets.dataset import Note
from getagrip.datasets.hot3d.holds import hold_name
from getagrip.datasets.tracks import Piece, Track
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io.files import LARGEST_JSON, is_plain_name, read_bytes, shown

HELD = "inhand"
REFS = (HELD, "scene_static", "scene_dynamic")
SIDES: dict[str, Side] = {"left": "left", "right": "right"}
LAST_FRAME = 10_000_000
FEWEST = 2
"""Frames of the shortest grasp that is taken: one silhouette says nothing about a motion."""


@dataclass(frozen=True)
class ListedGrasp:
    """An object in a hand, from frame ``start`` to ``end``, both included, as the list counts."""

    recording: str
    category: str
    side: Side
    start: int
    end: int


@dataclass(frozen=True)
class Timelines:
    """A list."""

    file: str
    grasps: tuple[ListedGrasp, ...]
    frames: dict[str, int]
    """How many frames each recording has."""

    def cut(self, tracks: Iterable[Track], note: Note, first_frame: int = 0) -> Iterator[Piece]:
        """The grasps of some tracks; ``first_frame`` is the list's number of a recording's first frame."""
        for track in tracks:
            for grasp in self.grasps:
                if (grasp.recording, grasp.category, grasp.side) != (_recording(track), track.category, track.side):
                    continue
                counted = track.numbers + first_frame
                rows = np.flatnonzero((counted >= grasp.start) & (counted <= grasp.end))
                name = f"{hold_name(track)}-{grasp.start:05d}-{grasp.end:05d}"
                if len(rows) < FEWEST:
                    note(f"{name}: hand and object are known in {len(rows)} of its frames: skipped")
                    continue
                made_of = f"in the hand, frames {grasp.start} to {grasp.end} of {self.file}"
                yield Piece(track.take(rows), name, made_of)


def _recording(track: Track) -> str:
    return f"{track.subject}_{track.sequence}"


def read(path: Path, note: Note = lambda _: None) -> Timelines:
    """A list of timelines; segments that end before they start are skipped, and reported. Raises ``InputError``."""
    grasps: list[ListedGrasp] = []
    frames: dict[str, int] = {}
    backwards = 0
    for n, timeline in enumerate(_list(path, "", _parsed(path))):
        name, category = timeline.get("seq_name"), timeline.get("cat")
        if not isinstance(name, str) or not is_plain_name(name):
            raise InputError(path, f"[{n}].seq_name", shown(name), "a recording, as P0010_b152143e")
        if not isinstance(category, str):
            raise InputError(path, f"[{n}].cat", shown(category), "the name of an object")
        length = _whole(path, f"[{n}].total_end", timeline.get("total_end"))
        if frames.setdefault(name, length) != length:
            raise InputError(path, f"[{n}].total_end", str(length), f"{frames[name]}, as before for {name}")
        for k, segment in enumerate(_list(path, f"[{n}].segments", timeline.get("segments"))):
            key = f"[{n}].segments[{k}]"
            start, end = (_whole(path, f"{key}.{which}", segment.get(which)) for which in ("st", "ed"))
            ref, side = segment.get("ref"), segment.get("side")
            if not isinstance(ref, str) or ref not in REFS:
                raise InputError(path, f"{key}.ref", shown(ref), f"one of {', '.join(REFS)}")
            if ref != HELD:
                continue
            if not isinstance(side, str) or side not in SIDES:
                raise InputError(path, f"{key}.side", shown(side), "left or right")
            if end < start:
                backwards += 1
            else:
                grasps.append(ListedGrasp(name, category, SIDES[side], start, end))
    if backwards:
        note(f"{path.name}: {backwards} grasps end before they start: skipped")
    return Timelines(path.name, tuple(grasps), frames)


def _parsed(path: Path) -> Any:
    try:
        return json.loads(read_bytes(path, LARGEST_JSON))
    except (ValueError, RecursionError) as error:  # RecursionError: nested thousands deep
        raise InputError(path, "", f"text that is no JSON ({error})", "a list of timelines") from error


def _list(path: Path, key: str, value: object) -> list[dict[str, Any]]:
    """A list of objects."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InputError(path, key, shown(value), "a list of objects")
    return value


def _whole(path: Path, key: str, value: object) -> int:
    if type(value) is not int or not 0 <= value <= LAST_FRAME:
        raise InputError(path, key, shown(value), f"a whole number from 0 to {LAST_FRAME}")
    return value
