"""The authors' later in-hand model: Dynamic, but distances between hand and object are asked to stay the same."""

from __future__ import annotations

from getagrip.fitting.energy import Energy
from getagrip.fitting.methods import OnStage, all_frames
from getagrip.fitting.objective import consistency_of, plus
from getagrip.fitting.problem import MethodResult, Problem

WEIGHT = 0.1
"""Weight of the term (``objective.consistency_of``): theirs is 1."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit ``dynamic`` with one more term, in all stages. Raises ``GetagripError`` when nothing can be rendered."""
    return all_frames.dynamic(problem, on_stage, energy_of)


def energy_of(problem: Problem) -> Energy:
    """Return Eq. 5 and the term."""
    return plus(all_frames.total_energy(problem, contact=1.0), consistency_of(problem, WEIGHT))
