"""The hypotheses of all segments that together have the least energy, links included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray


def best_chain(
    energy: Sequence[Float[ndarray, "_"]], links: Sequence[Float[ndarray, "_ _"]]
) -> tuple[list[int], float]:
    """Choose one hypothesis of each segment by dynamic programming; also return their energy.

    ``energy[i][k]`` is that of hypothesis k of segment i, ``links[i][k, l]`` that of following it by hypothesis l.
    """
    total, back = energy[0], []
    for own, link in zip(energy[1:], links, strict=True):
        through = total[:, None] + link
        back.append(np.argmin(through, axis=0))
        total = own + through.min(axis=0)
    chosen = [int(np.argmin(total))]
    for step in reversed(back):
        chosen.append(int(step[chosen[-1]]))
    return chosen[::-1], float(total.min())


def second_best(
    energy: Sequence[Float[ndarray, "_"]],
    links: Sequence[Float[ndarray, "_ _"]],
    copies: Sequence[Bool[ndarray, "_"]],
) -> float:
    """Return the least energy of a chain that differs from the chosen one, infinite where there is no other.

    ``copies[i]`` are the hypotheses of segment i that are as good as the chosen one, itself included.
    """
    others = []
    for i, same in enumerate(copies):
        without = [e.astype(float) for e in energy]
        without[i][same] = np.inf
        if np.isfinite(without[i]).any():
            others.append(best_chain(without, links)[1])
    return min(others, default=float("inf"))
