"""EPIC-HIT: timelines in EPIC-KITCHENS' videos, as the paper's authors published them (``epic_hit.json``).

Each belongs to a grasp of EPIC-Grasps' table, by its ``mp4_name``, which says what VISOR calls the object.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.clip import Segment
from getagrip.datasets.dataset import Note
from getagrip.datasets.epic.tables import LARGEST_TABLE, EpicGrasp
from getagrip.errors import InputError
from getagrip.grasps import timelines as lists
from getagrip.io.files import read_bytes, shown


@dataclass(frozen=True)
class EpicTimeline:
    """What a hand does with an object."""

    span: EpicGrasp
    """The object and its main hand, from the first to the last frame."""
    segments: tuple[Segment, ...]
    """By EPIC's frame numbers; they may overlap, and leave frames out."""


def read(path: Path, grasps: Sequence[EpicGrasp], note: Note) -> list[EpicTimeline]:
    """The timelines of a list, each once. Raises ``InputError``, which names the entry and the key."""
    content = read_bytes(path, LARGEST_TABLE)
    try:
        given = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "", f"text that is no JSON ({error})", "EPIC-HIT's list of timelines") from error
    if not isinstance(given, list) or not all(isinstance(entry, dict) for entry in given):
        raise InputError(path, "", shown(given), "a list of timelines, as epic_hit.json")
    by_film = {grasp.film: grasp for grasp in grasps if grasp.film}
    found: dict[str, EpicTimeline] = {}
    for n, entry in enumerate(given):
        timeline = _timeline(path, f"[{n}]", entry, by_film)
        if timeline.segments:
            found[timeline.span.name] = timeline
    lists.report_backwards(path, given, note)
    if len(found) < len(given):
        note(f"{path.name}: {len(given) - len(found)} of {len(given)} timelines are listed twice or empty: skipped")
    return list(found.values())


def _timeline(path: Path, key: str, entry: Mapping[str, object], by_film: Mapping[str, EpicGrasp]) -> EpicTimeline:
    film = entry.get("mp4_name")
    grasp = by_film.get(film.removesuffix(".mp4")) if isinstance(film, str) else None
    if grasp is None:
        raise InputError(path, f"{key}.mp4_name", shown(film), "the mp4_name of a grasp in EPIC-Grasps' table")
    for name, value in (("vid", grasp.video), ("cat", grasp.category)):
        if entry.get(name) != value:
            raise InputError(
                path, f"{key}.{name}", shown(entry.get(name)), f"{value}, as of {shown(film)} in the table"
            )
    side = entry.get("main_side")
    if side not in ("left", "right"):
        raise InputError(path, f"{key}.main_side", shown(side), "left or right")
    segments = lists.segments_of(path, f"{key}.segments", entry.get("segments"))
    if not segments:
        return EpicTimeline(grasp, ())
    first, last = min(s.first for s in segments), max(s.last for s in segments)
    return EpicTimeline(replace(grasp, side=side, start=first, end=last, note=""), segments)
