"""Agreement of people on stable grasps: temporal intersection over union."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from getagrip.annotate.marks import Mark


@dataclass(frozen=True)
class Agreement:
    """The agreement of two people, over the tasks that both have looked at."""

    first: str
    second: str
    tasks: int
    """Tasks that both have marked or discarded."""
    both_discarded: int
    one_discarded: int
    """Tasks in which one has found grasps and the other none."""
    grasps: int
    """Grasps of tasks in which an annotator found any, paired ones counted once."""
    iou: float | None
    """Their mean temporal IOU, 0 for those without a partner; None where there are none."""
    above_half: float | None
    """Share of them with an IOU above one half."""


def temporal_iou(a: tuple[int, int], b: tuple[int, int]) -> float:
    """Compute the IOU of two intervals of frames, ends included."""
    both = min(a[1], b[1]) - max(a[0], b[0]) + 1
    return max(0, both) / (a[1] - a[0] + 1 + b[1] - b[0] + 1 - max(0, both))


def match_grasps(ours: Sequence[Mark], theirs: Sequence[Mark]) -> list[float]:
    """Match the grasps of two people such that the sum of IOU is largest; return their IOU, 0 for unmatched ones.

    Grasps of different hands are not paired, nor such as do not overlap. The order of the people does not matter.
    """
    from scipy.optimize import linear_sum_assignment

    iou = np.zeros((len(ours), len(theirs)))
    for i, a in enumerate(ours):
        for j, b in enumerate(theirs):
            if a.grasp and b.grasp and a.side == b.side:
                iou[i, j] = temporal_iou(a.grasp, b.grasp)
    pairs = [value for value in iou[linear_sum_assignment(iou, maximize=True)].tolist() if value > 0]
    alone = len(ours) + len(theirs) - 2 * len(pairs)
    return sorted(pairs, reverse=True) + [0.0] * alone


def pairwise_agreements(marks: Sequence[Mark]) -> list[Agreement]:
    """Compute the agreement of every two people who have looked at the same tasks."""
    marked: dict[str, dict[str, list[Mark]]] = {}
    for mark in marks:
        if mark.interval or mark.reason:  # a start without an end says nothing yet
            marked.setdefault(mark.annotator, {}).setdefault(mark.task, []).append(mark)
    found = [_agreement_of_pair(a, b, marked[a], marked[b]) for a, b in combinations(sorted(marked), 2)]
    return [one for one in found if one.tasks]


def _agreement_of_pair(
    first: str, second: str, ours: dict[str, list[Mark]], theirs: dict[str, list[Mark]]
) -> Agreement:
    values, both, one = list[float](), 0, 0
    shared = sorted(ours.keys() & theirs.keys())
    for task in shared:
        a, b = ([mark for mark in marks[task] if mark.grasp] for marks in (ours, theirs))
        both += not a and not b
        one += bool(a) != bool(b)
        values += match_grasps(a, b)
    mean = float(np.mean(values)) if values else None
    half = float(np.mean(np.array(values) > 0.5)) if values else None
    return Agreement(first, second, len(shared), both, one, len(values), mean, half)
