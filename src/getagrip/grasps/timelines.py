"""Lists of what hands do with objects, as the paper's authors published them: HOT3D's and EPIC's (``*_hit.json``).

    [{"seq_name": "P0010_b152143e", "cat": "cellphone", "total_end": 3594,
      "segments": [{"st": 363, "ed": 383, "side": "left", "ref": "inhand"}, ...]}, ...]

``ref`` is ``inhand`` (a stable grasp, by their weakest test: ``stable``, ``consecutive``), ``scene_static`` or
``scene_dynamic``. ``st`` and ``ed`` are both included; a segment may begin in the frame in which the one before it
ends. Some segments end before they start. So their code (https://github.com/zhifanzhu/objects-along-hit) makes and
reads the lists.

In HOT3D's, numbers count, from 0, the images of the RGB camera (of a Quest 3 the first large one), and ``total_end`` is
their number. EPIC's has ``vid`` for ``seq_name``, EPIC's own frame numbers, and besides ``timeline_name``,
``main_side``, and ``mp4_name``, by which EPIC-Grasps' table knows the object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.clip import Segment
from getagrip.clip.timeline import State
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io.counts import counted
from getagrip.io.files import Json, is_plain_name, shown

STATES: dict[str, State] = {"inhand": "grasp", "scene_static": "static", "scene_dynamic": "contact"}
"""Our name of each ``ref``."""
SIDES: dict[object, Side | None] = {"left": "left", "right": "right", None: None}
LAST_FRAME = 10_000_000
MOST_SEGMENTS = 100_000
"""Most segments of a list; HOT3D's has 3288."""


@dataclass(frozen=True)
class Timeline:
    """An interaction with an object; its segments count frames as the list does."""

    sequence: str
    category: str
    segments: tuple[Segment, ...]

    @property
    def grasped(self) -> tuple[Segment, ...]:
        """The stable grasps."""
        return tuple(segment for segment in self.segments if segment.state == "grasp")


def read(
    path: Path, content: Sequence[Json], note: Callable[[str], None]
) -> tuple[tuple[Timeline, ...], dict[str, int]]:
    """Read HOT3D's timelines, and the number of frames of each recording.

    Segments that end before they start are skipped, and reported. Raises ``InputError`` in the name of the file.
    """
    found = []
    frames: dict[str, int] = {}
    for n, timeline in enumerate(content):
        name = timeline.get("seq_name")
        if not isinstance(name, str) or not is_plain_name(name):
            raise InputError(path, f"[{n}].seq_name", shown(name), "a recording, as P0010_b152143e")
        length = whole(path, f"[{n}].total_end", timeline.get("total_end"))
        if frames.setdefault(name, length) != length:
            raise InputError(path, f"[{n}].total_end", str(length), f"{frames[name]}, as before for {name}")
        category = timeline.get("cat")
        if not isinstance(category, str):
            raise InputError(path, f"[{n}].cat", shown(category), "the name of an object")
        found.append(Timeline(name, category, segments_of(path, f"[{n}].segments", timeline.get("segments"))))
    report_backwards(path, content, note)
    return tuple(found), frames


def segments_of(path: Path, key: str, value: object) -> tuple[Segment, ...]:
    """Parse the segments of a timeline; those that end before they start are left out. Raises ``InputError``."""
    if not isinstance(value, list) or not all(isinstance(segment, dict) for segment in value):
        raise InputError(path, key, shown(value), "a list of objects")
    if len(value) > MOST_SEGMENTS:
        raise InputError(path, key, f"{len(value)} segments", f"at most {MOST_SEGMENTS}")
    out = []
    for k, segment in enumerate(value):
        first, last = (whole(path, f"{key}[{k}].{end}", segment.get(end)) for end in ("st", "ed"))
        ref, side = segment.get("ref"), segment.get("side")
        if not isinstance(ref, str) or ref not in STATES:
            raise InputError(path, f"{key}[{k}].ref", shown(ref), f"one of {', '.join(STATES)}")
        state = STATES[ref]
        if (side is not None and not isinstance(side, str)) or side not in SIDES or (side is None and state == "grasp"):
            raise InputError(path, f"{key}[{k}].side", shown(side), "left or right")
        if first <= last:
            out.append(Segment(state, first, last, None if state == "static" else SIDES[side]))
    return tuple(out)


def report_backwards(path: Path, content: Sequence[Json], note: Callable[[str], None]) -> None:
    """Say how many segments end before they start; ``content`` has been read."""
    backwards = [s["ref"] for timeline in content for s in timeline["segments"] if s["ed"] < s["st"]]
    if backwards:
        grasps = counted(count := backwards.count("inhand"), "grasp")
        others = counted(len(backwards) - count, "other segment")
        note(f"{path.name}: {grasps} and {others} end before they start: skipped")


def whole(path: Path, key: str, value: object) -> int:
    """Parse the number of a frame. Raises ``InputError``."""
    if type(value) is not int or not 0 <= value <= LAST_FRAME:
        raise InputError(path, key, shown(value), f"a whole number from 0 to {LAST_FRAME}")
    return value
