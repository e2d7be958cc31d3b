"""Hand and object solved together, by all evidence on either and by the contact between them.

The hand's own evidence has refined it before, whatever it holds (``hand_refinement``). Here the same errors, under the
same prior, are parameters beside the object's motion (``MovingHand``). What is known of the object then tells of the
hand, above all how far away it is: of that its own silhouette says little, the object's much, and the two touch.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import OnHand
from getagrip.fitting.hand.hand_error_model import ROTATION_ERRORS, SIZE_ERROR, TRANSLATION_ERRORS
from getagrip.fitting.hand.hand_solution import SolvedHand
from getagrip.fitting.hand.refine_hand import HandRefinement, assumed_errors
from getagrip.fitting.motion import HandPrior, Motion, MovingHand, moving_hand
from getagrip.fitting.objective import energy_of_nat, hand_evidence_energy, sum_energies
from getagrip.fitting.problem import EnergyOf, Problem
from getagrip.fitting.solver.solve import evaluate, inverse_of_shared, minimise

M = TypeVar("M", bound=Motion)

HAND_DEPTH_SIGMAS_M = 0.018, 0.007
"""Standard deviations of the error along the camera's ray beside that in any direction: that all frames share, and of
each frame's own [m]; those of estimates from images (docs/datasets.md)."""
HAND_PRIOR_WEIGHT = 0.5
"""Weight of the prior against what it has in the hand's refinement: clips differ in how far their hands are off, so
that its tails are heavier than a square's. Chosen on training clips."""
HAND_STUDENT_T_DOF = 2.0
"""Degrees of freedom of Student's t: a clip's shift, turn and depth may each be off by more than is assumed."""
HAND_OBJECT_LEVEL_PX, HAND_OBJECT_ITERATIONS, WIDENED_PRIOR_ITERATIONS = 128, 8, (4, 4)
"""Resolution [px]; most iterations, and those of each round under a prior that is as wide as the errors before."""


def solve_with_hand(problem: Problem, motion: M, energy_of: EnergyOf) -> tuple[SolvedHand, M]:
    """Solve the first hypothesis together with the hand; return the hand, and the motions in it.

    The other hypotheses go with the hand. The hand of the problem was refined (``Problem.refinement``).
    """
    refinement = problem.refinement
    assert refinement is not None
    given, nat = problem.with_input_hand(), energy_of_nat(problem)
    frames, T_input = np.arange(len(given.clip)), given.clip.hand.T_cam_hand
    terms = sum_energies(energy_of(given), hand_evidence_energy(given))(HAND_OBJECT_LEVEL_PX, frames)
    start = _motion_in_moving_hand(refinement, motion.take(np.zeros(1, int)), nat)
    found = minimise(start, terms, T_input, HAND_OBJECT_ITERATIONS)
    for iterations in WIDENED_PRIOR_ITERATIONS:
        assumed = start.assumed.widened(found.motion.constant[0], found.motion.own[0], HAND_STUDENT_T_DOF)
        found = minimise(replace(found.motion, assumed=assumed), terms, T_input, iterations)
    x = _hand_errors(found.motion, refinement)
    begun = evaluate(start, terms, T_input, np.full(1, np.inf)).values[0]
    names = [term.name for term in terms if isinstance(term, OnHand)]
    before = dict(zip((term.name for term in terms), begun, strict=False))
    energy = {name: (float(before[name]), float(found.terms[name][0])) for name in names}
    covariance = nat * _covariance(found.motion, inverse_of_shared(found.motion, terms, T_input, last=8))
    rest = np.arange(1, len(motion.poses().scale))
    seen = refinement.seen
    hand = SolvedHand(seen.errors.T_cam_hand(x), covariance, energy, seen.share(x))
    return hand, found.motion.core.concatenate(motion.take(rest))


def _motion_in_moving_hand(refinement: HandRefinement, motion: M, nat: float) -> MovingHand[M]:
    """Put a motion into the refined hand."""
    assumed = assumed_errors("estimated", refinement.joints)
    hand, bias, jitter = refinement.seen.errors.tracked, assumed.bias, assumed.jitter
    constant = np.concatenate(
        [bias[TRANSLATION_ERRORS], bias[ROTATION_ERRORS], [HAND_DEPTH_SIGMAS_M[0], bias[SIZE_ERROR]]]
    )
    own = np.concatenate([jitter[TRANSLATION_ERRORS], jitter[ROTATION_ERRORS], [HAND_DEPTH_SIGMAS_M[1]]])
    a, b = refinement.shared, refinement.own
    return replace(
        MovingHand.around(motion, HandPrior.of(hand, constant, own, HAND_PRIOR_WEIGHT * nat)),
        constant=np.concatenate(
            [a[TRANSLATION_ERRORS], a[ROTATION_ERRORS], [0.0, a[SIZE_ERROR] + b[:, SIZE_ERROR].mean()]]
        )[None],
        own=np.concatenate([b[:, TRANSLATION_ERRORS], b[:, ROTATION_ERRORS], np.zeros((len(b), 1))], axis=1)[None],
    )


def _hand_errors(motion: MovingHand[M], refinement: HandRefinement) -> Float[ndarray, "N P"]:
    """Return the errors of the hand in every frame, as ``HandErrors`` has them; fingers stay as they were refined."""
    x, solved = refinement.shared + refinement.own, motion.constant[0, :-1] + motion.own[0]
    x[:, ROTATION_ERRORS], x[:, SIZE_ERROR] = solved[:, moving_hand.TURN_SLICE], motion.constant[0, -1]
    x[:, TRANSLATION_ERRORS] = (
        solved[:, moving_hand.SHIFT_SLICE] + solved[:, moving_hand.RAY_SHIFT_INDEX, None] * motion.assumed.rays
    )
    return x


def _covariance(motion: MovingHand[M], inverse: Float[ndarray, "8 8"]) -> Float[ndarray, "6 6"]:
    """Return the part of shift and turn that all frames share, the mean ray's among them."""
    J = np.eye(6, 8)
    J[:3, moving_hand.RAY_SHIFT_INDEX] = motion.assumed.rays.mean(axis=0)
    return np.asarray(J @ inverse @ J.T)
