"""The authors' later in-hand model: Dynamic, but distances between hand and object are asked to stay the same."""

from __future__ import annotations

from getagrip.fitting.energy import Energy
from getagrip.fitting.methods import OnStage, all_frames
from getagrip.fitting.objective import distance_consistency_energy, sum_energies
from getagrip.fitting.problem import MethodResult, Problem

CONTACT_CONSISTENCY_WEIGHT = 0.1
"""Weight of the term (``objective.consistency_of``): theirs is 1."""


def fit_contact_consistency(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit ``dynamic`` with one more term, in all stages. Raises ``GetagripError`` when nothing can be rendered."""
    return all_frames.dynamic(problem, on_stage, total_energy_with_consistency)


def total_energy_with_consistency(problem: Problem) -> Energy:
    """Return Eq. 5 and the term."""
    return sum_energies(
        all_frames.total_energy(problem, contact=1.0), distance_consistency_energy(problem, CONTACT_CONSISTENCY_WEIGHT)
    )
