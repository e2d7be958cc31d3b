"""How long stable grasps last, category by category: the paper's dataset tables."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from getagrip.datasets.epic.tables import numbering_rate, read_grasps
from getagrip.errors import InputError
from getagrip.io.files import csv_rows, plain, read_bytes, shown

Fps = Literal["paper", "true"]
PAPER_FPS = 50.0
"""Frames per second by which the paper divides all of EPIC-Grasps' durations."""
LARGEST = 64 * 2**20
"""Limit in bytes of a list."""
LONGEST = 86400.0
"""No grasp lasts longer [s]."""
ALL = "All"


@dataclass(frozen=True)
class ListedGrasp:
    """A stable grasp of a list."""

    category: str
    side: str
    duration: float
    """In seconds."""


@dataclass(frozen=True)
class CategoryDurations:
    """The grasps of one category, or of all of them."""

    category: str
    mean: float
    std: float
    """Standard deviation of these grasps, divided by n [s]."""
    longest: float
    clips: int
    left: int
    right: int


def durations(grasps: Sequence[ListedGrasp]) -> list[CategoryDurations]:
    """A row for each category in the order of the alphabet, then one for all; none where there are no grasps."""
    categories = sorted({grasp.category for grasp in grasps})
    groups = {category: [grasp for grasp in grasps if grasp.category == category] for category in categories}
    return [_row(category, group) for category, group in [*groups.items(), (ALL, list(grasps))] if group]


def _row(category: str, grasps: Sequence[ListedGrasp]) -> CategoryDurations:
    seconds = np.array([grasp.duration for grasp in grasps])
    sides = [grasp.side for grasp in grasps]
    counts = (len(grasps), sides.count("left"), sides.count("right"))
    return CategoryDurations(category, float(seconds.mean()), float(seconds.std()), float(seconds.max()), *counts)


def read_epic(path: Path, fps: Fps = "paper", errata: Path | None = None) -> list[ListedGrasp]:
    """EPIC-Grasps' table, corrected where errata are given. Raises ``InputError``, which names the line and the column.

    ``paper``: 50 frames per second in every video. ``true``: as EPIC numbers the frames of each video.
    """
    return [
        ListedGrasp(one.category, one.side, one.frames / (PAPER_FPS if fps == "paper" else numbering_rate(one.video)))
        for one in read_grasps(path, errata)
    ]


def read_list(path: Path) -> list[ListedGrasp]:
    """A list that ``getagrip segment`` wrote, CSV or JSON. Raises ``InputError``, which names the row and the key."""
    content = read_bytes(path, LARGEST)
    is_json = content.lstrip()[:1] in (b"[", b"{")
    rows = _json_rows(path, content) if is_json else _csv_rows(path, content)
    return [_grasp(path, where, row) for where, row in rows]


def _json_rows(path: Path, content: bytes) -> list[tuple[str, dict[str, Any]]]:
    try:
        rows = json.loads(content)
    except (ValueError, RecursionError) as error:  # RecursionError: nested thousands deep
        raise InputError(path, "", f"text that is no JSON ({error})", "a list of grasps, CSV or JSON") from error
    if not isinstance(rows, list):
        raise InputError(path, "", f"a JSON {type(rows).__name__}", "a list, as `getagrip segment --json` writes it")
    for n, row in enumerate(rows):
        if not isinstance(row, dict):
            raise InputError(path, f"[{n}]", shown(row), "an object with object, side and duration")
    return [(f"[{n}].", row) for n, row in enumerate(rows)]


def _csv_rows(path: Path, content: bytes) -> Sequence[tuple[str, dict[str, Any]]]:
    heads, rows = csv_rows(path, content, "a list of grasps, CSV or JSON")
    for head in ("object", "side", "duration"):
        if heads.count(head) != 1:
            given = f"{heads.count(head)} columns of this name among {shown(heads)}"
            raise InputError(
                path, f"line 1, {head}", given, "one, as in the segments.csv that `getagrip segment` writes"
            )
    return rows


def _grasp(path: Path, where: str, row: dict[str, Any]) -> ListedGrasp:
    """A row, checked."""
    for key in ("object", "side", "duration"):
        if key not in row:
            raise InputError(path, f"{where}{key}", "no such key", "the keys object, side and duration")
    category, side = row["object"], row["side"]
    if not (isinstance(category, str) and category.strip() and category.isprintable()):
        raise InputError(path, f"{where}object", shown(category), "the name of a kind of objects")
    if side not in ("left", "right"):
        raise InputError(path, f"{where}side", shown(side), "left or right")
    try:
        duration = math.nan if isinstance(row["duration"], bool) else float(row["duration"])
    except (TypeError, ValueError, OverflowError):
        duration = math.nan
    if not 0.0 < duration <= LONGEST:
        raise InputError(
            path, f"{where}duration", plain(str(row["duration"])), f"seconds, above 0, {LONGEST:g} at most"
        )
    return ListedGrasp(category, side, duration)
