"""Lists of what hands do with HOT3D's objects, as the paper's authors published them (``hot3d_hit.json``).

    [{"seq_name": "P0010_b152143e", "cat": "cellphone", "total_end": 3594,
      "segments": [{"st": 363, "ed": 383, "side": "left", "ref": "inhand"}, ...]}, ...]

``ref`` is ``inhand`` (a stable grasp, by their weakest test: ``stable``, ``consecutive``), ``scene_static`` or
``scene_dynamic``; only the first are read. ``st`` and ``ed`` are both included. They count, from 0, the images of the
RGB camera (of a Quest 3 the first large one), and ``total_end`` is their number: so their code
(https://github.com/zhifanzhu/objects-along-hit) makes and reads the list. Some of its segments end before they start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io.files import is_plain_name, shown

HELD = "inhand"
REFS = (HELD, "scene_static", "scene_dynamic")
SIDES: dict[str, Side] = {"left": "left", "right": "right"}
LAST_FRAME = 10_000_000
Span = tuple[str, Side, str, int, int]
"""Recording, hand, object, first and last frame as the list counts."""


def read(
    path: Path, content: Sequence[dict[str, Any]], note: Callable[[str], None]
) -> tuple[list[Span], dict[str, int]]:
    """The stable grasps of timelines, and how many frames each recording has.

    Segments that end before they start are skipped, and reported. Raises ``InputError`` in the name of the file.
    """
    spans: list[Span] = []
    frames: dict[str, int] = {}
    backwards = 0
    for n, timeline in enumerate(content):
        name, category = timeline.get("seq_name"), timeline.get("cat")
        if not isinstance(name, str) or not is_plain_name(name):
            raise InputError(path, f"[{n}].seq_name", shown(name), "a recording, as P0010_b152143e")
        if not isinstance(category, str):
            raise InputError(path, f"[{n}].cat", shown(category), "the name of an object")
        length = _whole(path, f"[{n}].total_end", timeline.get("total_end"))
        if frames.setdefault(name, length) != length:
            raise InputError(path, f"[{n}].total_end", str(length), f"{frames[name]}, as before for {name}")
        segments = timeline.get("segments")
        if not isinstance(segments, list) or not all(isinstance(segment, dict) for segment in segments):
            raise InputError(path, f"[{n}].segments", shown(segments), "a list of objects")
        for k, segment in enumerate(segments):
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
                spans.append((name, SIDES[side], category, start, end))
    if backwards:
        note(f"{path.name}: {backwards} grasps end before they start: skipped")
    return spans, frames


def _whole(path: Path, key: str, value: object) -> int:
    if type(value) is not int or not 0 <= value <= LAST_FRAME:
        raise InputError(path, key, shown(value), f"a whole number from 0 to {LAST_FRAME}")
    return value
