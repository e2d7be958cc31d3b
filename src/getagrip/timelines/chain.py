"""The hypotheses of all segments that together have the least energy, links included.

A link is what it costs to take a hypothesis of one segment for the same object as a hypothesis of the next. The one is
followed by the masks to where the other begins, and the other back to where the one ends, along several paths each:
what counts is a path's own energy, and how far off it ends. Either may lose the object on the way, behind the hand: the
better of the two counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.timelines.following import Paths
from getagrip.timelines.hypotheses import Hypotheses
from getagrip.timelines.link_term import SLIP


def link_cost(mesh: Mesh, paths: Paths, start: Hypotheses, ends: Hypotheses, most: float) -> Float[ndarray, "K L"]:
    """Compute the energy of each pair of hypotheses of two segments [px^2], ``most`` at the most, each at one frame.

    ``paths`` lead from ``start`` to the frame that ``ends`` are of.
    """
    d2 = distance2(mesh, paths.found, ends)
    own = paths.found.energy - start.energy[paths.start]
    cost = np.full((len(start.R), len(ends.R)), most)
    np.minimum.at(cost, paths.start, own[:, None] - own.min() + most * d2 / (d2 + (SLIP * mesh.diameter) ** 2))
    return cost


def distance2(mesh: Mesh, one: Hypotheses, other: Hypotheses) -> Float[ndarray, "K L"]:
    """Compute the mean squared distance of the vertices between hypotheses, each at one frame [m^2]."""
    about = mesh.vertices - mesh.centre
    posed = [h.scale[:, None, None] * about @ np.swapaxes(h.R[:, 0], -1, -2) + h.centre[:, :1] for h in (one, other)]
    return np.asarray(np.sum((posed[0][:, None] - posed[1][None]) ** 2, axis=-1).mean(axis=-1))


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
