"""The cost of linking a hypothesis of one segment to a hypothesis of the next, as poses of the same object.

The one is followed by the masks to where the other begins, and the other back to where the one ends, along several
paths each: what counts is a path's own energy, and how far off it ends. Either may lose the object on the way, behind
the hand: the better of the two counts.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.timelines.following import Paths, follow
from getagrip.timelines.footage import Footage
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


def followed_to(footage: Footage, begin: int, rows: Int[ndarray, "n"], start: Hypotheses) -> Paths:
    """Follow hypotheses of the frame ``begin`` into later frames, or earlier ones, in the order of the frames."""
    step = 1 if rows[-1] > begin else -1
    through = np.arange(begin + step, rows[-1] + step, step)
    return follow(footage, begin, through, start).at((rows - through[0]) * step)
