"""How well found intervals meet true ones: overlap in time, F1, errors of starts and ends, and false finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Span = tuple[int, int]
"""First and last frame, both included."""


@dataclass(frozen=True)
class Match:
    """A true interval, and the found one that overlaps it most; each found one is matched once.

    Attributes:
        tiou: intersection over union of their frames; 0 where nothing overlaps it.
        start, end: found minus true frame; None where nothing overlaps it.
    """

    tiou: float
    start: int | None
    end: int | None


@dataclass(frozen=True)
class Matched:
    """The intervals of a sequence."""

    matches: tuple[Match, ...]
    """One for each true interval."""
    found: int
    """How many were found."""


@dataclass(frozen=True)
class Summary:
    """Over sequences. NaN where there is nothing to average.

    Attributes:
        tiou: mean over true intervals, 0 for those that nothing overlaps.
        f1: of intervals that count as found from a tIoU of .5 and .7 on, over all sequences together.
        start, end: mean absolute errors of those that something overlaps [frames].
        missed: true intervals that nothing overlaps.
        false: sequences without a true interval in which some were found, and how many have none.
    """

    sequences: int
    true: int
    tiou: float
    f1: tuple[float, float]
    start: float
    end: float
    missed: int
    false: tuple[int, int]


def tiou(a: Span, b: Span) -> float:
    """Compute the intersection over union of two intervals of frames."""
    both = min(a[1], b[1]) - max(a[0], b[0]) + 1
    return max(both, 0) / (max(a[1], b[1]) - min(a[0], b[0]) + 1) if both > 0 else 0.0


def matched(true: Sequence[Span], found: Sequence[Span]) -> Matched:
    """Match true and found intervals, those that overlap most first."""
    pairs = sorted(((tiou(a, b), i, j) for i, a in enumerate(true) for j, b in enumerate(found)), reverse=True)
    partner: dict[int, int] = {}
    for overlap, i, j in pairs:
        if overlap > 0.0 and i not in partner and j not in partner.values():
            partner[i] = j
    out = []
    for i, a in enumerate(true):
        if i not in partner:
            out.append(Match(0.0, None, None))
            continue
        b = found[partner[i]]
        out.append(Match(tiou(a, b), b[0] - a[0], b[1] - a[1]))
    return Matched(tuple(out), len(found))


def summary(sequences: Sequence[Matched]) -> Summary:
    """Summarise the intervals of all sequences together."""
    matches = [match for one in sequences for match in one.matches]
    overlaps = np.array([match.tiou for match in matches])
    found = sum(one.found for one in sequences)
    right = [int((overlaps >= least).sum()) for least in (0.5, 0.7)]
    total = len(matches) + found
    f1 = [2.0 * n / total if total else float("nan") for n in right]
    empty = [one for one in sequences if not one.matches]
    return Summary(
        sequences=len(sequences),
        true=len(matches),
        tiou=_mean(overlaps),
        f1=(f1[0], f1[1]),
        start=_mean(np.abs([match.start for match in matches if match.start is not None])),
        end=_mean(np.abs([match.end for match in matches if match.end is not None])),
        missed=sum(match.start is None for match in matches),
        false=(sum(one.found > 0 for one in empty), len(empty)),
    )


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
