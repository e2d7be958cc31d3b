"""Counts of a dataset of stable grasps: the figures of the paper's comparison of datasets that can be counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.datasets.epic.tables import EpicGrasp, subject_of
from getagrip.grasps.lists import BETWEEN, ListedGrasp


@dataclass(frozen=True)
class Counts:
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


def of_epic(grasps: Sequence[EpicGrasp]) -> Counts:
    """Count EPIC-Grasps' table."""
    masks = [grasp.masks for grasp in grasps if grasp.masks is not None]
    sides = [grasp.side for grasp in grasps]
    return Counts(
        environments=len({grasp.video for grasp in grasps}),
        subjects=len({subject_of(grasp.video) for grasp in grasps}),
        categories=len({grasp.category for grasp in grasps}),
        instances=len({(grasp.video, grasp.category) for grasp in grasps}),
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=sum(masks) if len(masks) == len(grasps) else None,
    )


def of_list(grasps: Sequence[ListedGrasp], folder: Path | None) -> Counts:
    """Count a list, and the clips beside it where it is in a folder of clips.

    Subjects are known where sequences are named as imports name them, ``<subject>--...``.
    """
    subjects = {grasp.sequence.partition(BETWEEN)[0] for grasp in grasps if BETWEEN in grasp.sequence}
    named = all(BETWEEN in grasp.sequence for grasp in grasps)
    sides = [grasp.side for grasp in grasps]
    return Counts(
        environments=None,
        subjects=len(subjects) if named else None,
        categories=len({grasp.object for grasp in grasps}),
        instances=None,
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=None if folder is None else sum(1 for _ in folder.glob("*/masks/object/*.png")),
    )
