"""How long stable grasps last, category by category: the paper's dataset tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from getagrip.datasets.epic.tables import EpicGrasp, numbering_rate
from getagrip.errors import InputError
from getagrip.grasps.lists import ListedGrasp

Fps = Literal["paper", "true"]
PAPER_FPS = 50.0
"""Frames per second by which the paper divides all of EPIC-Grasps' durations."""
ALL = "All"


@dataclass(frozen=True)
class LastingGrasp:
    """A stable grasp, as far as the tables are about it."""

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


def durations(grasps: Sequence[LastingGrasp]) -> list[CategoryDurations]:
    """Return a row for each category in alphabetical order, then one for all; none where there are no grasps."""
    categories = sorted({grasp.category for grasp in grasps})
    groups = {category: [grasp for grasp in grasps if grasp.category == category] for category in categories}
    return [_row(category, group) for category, group in [*groups.items(), (ALL, list(grasps))] if group]


def _row(category: str, grasps: Sequence[LastingGrasp]) -> CategoryDurations:
    seconds = np.array([grasp.duration for grasp in grasps])
    sides = [grasp.side for grasp in grasps]
    counts = (len(grasps), sides.count("left"), sides.count("right"))
    return CategoryDurations(category, float(seconds.mean()), float(seconds.std()), float(seconds.max()), *counts)


def of_epic(grasps: Sequence[EpicGrasp], fps: Fps = "paper") -> list[LastingGrasp]:
    """List the durations of EPIC-Grasps.

    ``paper``: 50 frames per second in every video. ``true``: as EPIC numbers the frames of each video.
    """
    return [
        LastingGrasp(one.category, one.side, one.frames / (PAPER_FPS if fps == "paper" else numbering_rate(one.video)))
        for one in grasps
    ]


def of_list(path: Path, grasps: Sequence[ListedGrasp]) -> list[LastingGrasp]:
    """Return the durations in a list. Raises ``InputError`` where it does not say how long a grasp lasts."""
    for n, grasp in enumerate(grasps):
        if grasp.duration is None:
            raise InputError(path, f"grasp {n + 1}, duration", "none", "how long it lasts, in seconds")
    return [LastingGrasp(grasp.object, grasp.side, grasp.duration or 0.0) for grasp in grasps]
