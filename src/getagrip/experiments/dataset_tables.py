"""The paper's dataset tables: how long stable grasps last, category by category, and what a dataset has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from getagrip.datasets.epic.tables import EpicGrasp, numbering_rate, subject_of
from getagrip.errors import InputError
from getagrip.grasps.lists import CLIP_NAME_SEPARATOR, ListedGrasp

Fps = Literal["paper", "true"]
PAPER_FPS = 50.0
"""Frames per second by which the paper divides all of EPIC-Grasps' durations."""
ALL_CATEGORIES_ROW = "All"


@dataclass(frozen=True)
class GraspDuration:
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


def durations_by_category(grasps: Sequence[GraspDuration]) -> list[CategoryDurations]:
    """Return a row for each category in alphabetical order, then one for all; none where there are no grasps."""
    categories = sorted({grasp.category for grasp in grasps})
    groups = {category: [grasp for grasp in grasps if grasp.category == category] for category in categories}
    return [
        _category_durations(category, group)
        for category, group in [*groups.items(), (ALL_CATEGORIES_ROW, list(grasps))]
        if group
    ]


def _category_durations(category: str, grasps: Sequence[GraspDuration]) -> CategoryDurations:
    seconds = np.array([grasp.duration for grasp in grasps])
    sides = [grasp.side for grasp in grasps]
    counts = (len(grasps), sides.count("left"), sides.count("right"))
    return CategoryDurations(category, float(seconds.mean()), float(seconds.std()), float(seconds.max()), *counts)


def epic_durations(grasps: Sequence[EpicGrasp], fps: Fps = "paper") -> list[GraspDuration]:
    """List the durations of EPIC-Grasps.

    ``paper``: 50 frames per second in every video. ``true``: as EPIC numbers the frames of each video.
    """
    return [
        GraspDuration(one.category, one.side, one.frames / (PAPER_FPS if fps == "paper" else numbering_rate(one.video)))
        for one in grasps
    ]


def grasp_list_durations(path: Path, grasps: Sequence[ListedGrasp]) -> list[GraspDuration]:
    """Return the durations in a list. Raises ``InputError`` where it does not say how long a grasp lasts."""
    for n, grasp in enumerate(grasps):
        if grasp.duration is None:
            raise InputError(path, f"grasp {n + 1}, duration", "none", "how long it lasts, in seconds")
    return [GraspDuration(grasp.object, grasp.side, grasp.duration or 0.0) for grasp in grasps]


@dataclass(frozen=True)
class DatasetCounts:
    """How many of each a dataset has; None: its files do not say."""

    environments: int | None
    """Videos: what the paper calls environments."""
    subjects: int | None
    categories: int
    instances: int | None
    """Objects: of EPIC-Grasps a category in a video, as in the paper."""
    grasps: int
    left: int
    right: int
    masks: int | None
    """Masks of hand and object, as in EPIC-Grasps' table (``n_unfiltered_masks``); of a folder, masks of the object."""


def count_epic_grasps(grasps: Sequence[EpicGrasp]) -> DatasetCounts:
    """Count EPIC-Grasps' table."""
    masks = [grasp.masks for grasp in grasps if grasp.masks is not None]
    sides = [grasp.side for grasp in grasps]
    return DatasetCounts(
        environments=len({grasp.video for grasp in grasps}),
        subjects=len({subject_of(grasp.video) for grasp in grasps}),
        categories=len({grasp.category for grasp in grasps}),
        instances=len({(grasp.video, grasp.category) for grasp in grasps}),
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=sum(masks) if len(masks) == len(grasps) else None,
    )


def count_grasp_list(grasps: Sequence[ListedGrasp], folder: Path | None) -> DatasetCounts:
    """Count a list, and the clips beside it where it is in a folder of clips.

    Subjects are known where sequences are named as imports name them, ``<subject>--...``.
    """
    subjects = {
        grasp.sequence.partition(CLIP_NAME_SEPARATOR)[0] for grasp in grasps if CLIP_NAME_SEPARATOR in grasp.sequence
    }
    named = all(CLIP_NAME_SEPARATOR in grasp.sequence for grasp in grasps)
    sides = [grasp.side for grasp in grasps]
    return DatasetCounts(
        environments=None,
        subjects=len(subjects) if named else None,
        categories=len({grasp.object for grasp in grasps}),
        instances=None,
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=None if folder is None else sum(1 for _ in folder.glob("*/masks/object/*.png")),
    )
