"""What it costs to take a hypothesis of one segment for the same object as a hypothesis of the next.

The one is followed by the masks to where the other begins, and the other back to where the one ends. Either may lose
the object on the way, behind the hand: the better of the two counts.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.timelines.following import follow
from getagrip.timelines.footage import Footage
from getagrip.timelines.hypotheses import Hypotheses
from getagrip.timelines.link_term import SLIP


def link_cost(
    footage: Footage, before: tuple[Hypotheses, int], after: tuple[Hypotheses, int], most: float
) -> Float[ndarray, "K L"]:
    """Energy of each pair of hypotheses of two segments [px^2], ``most`` at the most.

    Given are both at one frame: at the last of the one segment, and at the first of the other, and which these are.
    """
    (one, end), (other, begin) = before, after
    mesh = footage.clip.mesh
    forward = follow(footage, np.arange(end + 1, begin + 1), one).at(np.array([-1]))
    back = follow(footage, np.arange(begin - 1, end - 1, -1), other).at(np.array([-1]))
    d2 = np.minimum(distance2(mesh, forward, other), distance2(mesh, one, back))
    return np.asarray(most * d2 / (d2 + (SLIP * mesh.diameter) ** 2))


def distance2(mesh: Mesh, one: Hypotheses, other: Hypotheses) -> Float[ndarray, "K L"]:
    """Mean squared distance of the vertices between hypotheses, each at one frame [m^2]."""
    about = mesh.vertices - mesh.centre
    posed = [h.scale[:, None, None] * about @ np.swapaxes(h.R[:, 0], -1, -2) + h.centre[:, :1] for h in (one, other)]
    return np.asarray(np.sum((posed[0][:, None] - posed[1][None]) ** 2, axis=-1).mean(axis=-1))


def followed_into(footage: Footage, static: Hypotheses, gap: Int[ndarray, "m"], rows: Int[ndarray, "n"]) -> Hypotheses:
    """Static hypotheses followed through a gap and on to some frames, all in the order in which they are met."""
    through = np.concatenate(
        [gap, np.arange(rows[0], rows[-1] + 1) if rows[-1] >= rows[0] else np.arange(rows[0], rows[-1] - 1, -1)]
    )
    found = follow(footage, through, static.at(np.array([0])))
    return found.at(np.array([int(np.flatnonzero(through == row)[0]) for row in rows]))
