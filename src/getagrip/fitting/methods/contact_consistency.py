"""The authors' later in-hand model: Dynamic, but distances between hand and object are asked to stay the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from getagrip.fitting.methods import all_frames as joint
from getagrip.fitting.objective import consistency_of
from getagrip.fitting.problem import Found, Problem

WEIGHT = 0.1
"""Of the term (``objective.consistency_of``): theirs is 1."""


def fit(problem: Problem, watch: Callable[[str], None]) -> Found:
    """Dynamic with one term more, in all stages. Raises ``GetagripError`` when nothing can be rendered."""
    free = replace(problem, options=replace(problem.options, method="dynamic"))
    return joint.fit(free, watch, consistency_of(problem, WEIGHT))
