"""The cheapest division of a sequence into segments, each in a state, by dynamic programming (semi-Markov).

Costs belong to whole windows of frames, not to single frames, so that a segment may pay for what all of its frames
share: ``F(j) = min over i, s of F(i) + C(i, j, s)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray


@dataclass(frozen=True)
class Division:
    """A sequence in segments.

    Attributes:
        spans: (n, 2) first and last frame of each segment, both included; they follow each other from the first frame.
        states: (n,) state of each; neighbours may be in the same, each for itself.
        cost: sum of the segments' costs.
    """

    spans: Int[ndarray, "n 2"]
    states: Int[ndarray, "n"]
    cost: float


def cheapest(cost: Float[ndarray, "S T T"]) -> Division:
    """Find the cheapest division of T frames; ``cost[s, i, j]`` is that of state s in the frames i to j, both included.

    Costs may be infinite, where a state is impossible; entries with j < i are not read. If no division is finite, the
    cost is infinite and there are no segments.
    """
    T = cost.shape[1]
    of_best, state = cost.min(axis=0), cost.argmin(axis=0)
    best, start = np.full(T + 1, np.inf), np.zeros(T + 1, int)  # of the frames before the given one
    best[0] = 0.0
    for end in range(1, T + 1):
        total = best[:end] + of_best[:end, end - 1]
        start[end] = np.argmin(total)
        best[end] = total[start[end]]
    spans = []
    end = T if np.isfinite(best[T]) else 0
    while end > 0:
        spans.append((start[end], end - 1))
        end = int(start[end])
    span = np.array(spans[::-1], int).reshape(-1, 2)
    return Division(span, state[span[:, 0], span[:, 1]], float(best[T]))


def margins(cost: Float[ndarray, "S T T"], division: Division) -> Float[ndarray, "n"]:
    """Return how much more the next best division costs, for each segment of the cheapest one.

    The next best is that of the divisions in which none of the middle half of the segment's frames is in its state. Not
    negative; infinite where no other is possible.
    """
    out = np.empty(len(division.states))
    for k, ((first, last), state) in enumerate(zip(division.spans, division.states, strict=True)):
        edge = (last + 1 - first) // 4
        without = cost.copy()
        without[state, : last - edge + 1, first + edge :] = np.inf
        out[k] = cheapest(without).cost - division.cost
    return np.maximum(out, 0.0)
