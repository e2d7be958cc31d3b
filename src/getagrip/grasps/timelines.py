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
from getagrip.io.files import Json, is_portable_name, shorten_value
from getagrip.io.terminal import format_count

STATE_OF_REF: dict[str, State] = {"inhand": "grasp", "scene_static": "static", "scene_dynamic": "contact"}
"""Our name of each ``ref``."""
SIDE_OF_NAME: dict[object, Side | None] = {"left": "left", "right": "right", None: None}
MAX_FRAME_NUMBER = 10_000_000
MAX_TIMELINE_SEGMENTS = 100_000
"""Most segments of a list; HOT3D's has 3288."""


@dataclass(frozen=True)
class ListedTimeline:
    """An interaction with an object; its segments count frames as the list does."""

    sequence: str
    category: str
    segments: tuple[Segment, ...]

    @property
    def grasped(self) -> tuple[Segment, ...]:
        """The stable grasps."""
        return tuple(segment for segment in self.segments if segment.state == "grasp")


def read_hot3d_timelines(
    path: Path, content: Sequence[Json], note: Callable[[str], None]
) -> tuple[tuple[ListedTimeline, ...], dict[str, int]]:
    """Read HOT3D's timelines, and the number of frames of each recording.

    Segments that end before they start are skipped, and reported. Raises ``InputError`` in the name of the file.
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
        found.append(
            ListedTimeline(name, category, parse_timeline_segments(path, f"[{n}].segments", timeline.get("segments")))
        )
    report_backwards(path, content, note)
    return tuple(found), frames


def parse_timeline_segments(path: Path, key: str, value: object) -> tuple[Segment, ...]:
    """Parse the segments of a timeline; those that end before they start are left out. Raises ``InputError``."""
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
        if (
            (side is not None and not isinstance(side, str))
            or side not in SIDE_OF_NAME
            or (side is None and state == "grasp")
        ):
            raise InputError(path, f"{key}[{k}].side", shorten_value(side), "left or right")
        if first <= last:
            out.append(Segment(state, first, last, None if state == "static" else SIDE_OF_NAME[side]))
    return tuple(out)


def report_backwards(path: Path, content: Sequence[Json], note: Callable[[str], None]) -> None:
    """Say how many segments end before they start; ``content`` has been read."""
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
