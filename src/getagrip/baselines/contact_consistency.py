"""The authors' later in-hand model: Dynamic, but distances between hand and object are asked to stay the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from jaxtyping import Int
from numpy import ndarray

from getagrip import joint
from getagrip.contact import HandContacts, spread_points
from getagrip.energy import Term
from getagrip.energy.contact_consistency import ContactConsistencyTerm
from getagrip.problem import Found, Problem
from getagrip.search import Stage

WEIGHT = 0.1
"""Of the mean absolute change of squared distance, before the focal length and the masks' mean area: theirs is 1."""
PER_REGION, POINTS = 2, 20
"""Points of each contact region of the hand, and of the object, that stand for all: theirs are all vertices."""


def fit(problem: Problem, watch: Callable[[str], None]) -> Found:
    """Dynamic with one term more. Raises ``GetagripError`` when nothing can be rendered."""
    clip, observation = problem.clip, problem.observation
    vertices = clip.mesh.vertices - clip.mesh.centre
    points = vertices[spread_points(vertices, POINTS)]
    hand = HandContacts.of(clip.hand, PER_REGION)
    # Their masks' term is divided by the mask's area, ours is not.
    weight = WEIGHT * observation.area.mean() * observation.K[:, 0]

    def consistency(stage: Stage, index: Int[ndarray, "n"]) -> Sequence[Term]:
        return [ContactConsistencyTerm(points, hand.position[index], weight[index])]

    free = replace(problem, options=replace(problem.options, method="dynamic"))
    return joint.fit(free, watch, consistency)
