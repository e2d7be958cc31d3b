"""Hand and object solved together, by all evidence on either and by the contact between them.

The hand was refined by its own evidence before (``refine_hand``). Here the same errors, under the same prior, are
parameters beside the object's motion (``MovingHand``). So evidence on the object tells about the hand, above all its
distance: the hand's own silhouette says little about it, the object's much, and the two touch.
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
from getagrip.fitting.motion import HandPrior, Motion, MovingHand
from getagrip.fitting.motion.moving_hand import RAY_SHIFT_INDEX, SHIFT_SLICE, TURN_SLICE
from getagrip.fitting.objective import energy_of_nat, hand_evidence_energy, sum_energies
from getagrip.fitting.problem import EnergyOf, Problem
from getagrip.fitting.solver.solve import evaluate, inverse_of_shared, minimise

M = TypeVar("M", bound=Motion)

HAND_DEPTH_SIGMAS_M = 0.018, 0.007
"""Standard deviations of the error along the camera's ray, beside the error in any direction: the error that all frames
share, and each frame's own [m], as in estimates from images (docs/datasets.md)."""
HAND_PRIOR_WEIGHT = 0.5
"""Weight of the prior, relative to the hand's refinement: hands of different clips differ in accuracy, so that the
prior's tails are heavier than a square's. Chosen on training clips."""
HAND_STUDENT_T_DOF = 2.0
"""Degrees of freedom of Student's t: a clip's shift, turn and depth may each be off by more than is assumed."""
HAND_OBJECT_LEVEL_PX, HAND_OBJECT_ITERATIONS, WIDENED_PRIOR_ITERATIONS = 128, 8, (4, 4)
"""Resolution [px]; maximum number of iterations, first and in each round under a prior as wide as the errors before."""


def solve_with_hand(problem: Problem, motion: M, energy_of: EnergyOf) -> tuple[SolvedHand, M]:
    """Solve the first hypothesis together with the hand; return the hand, and all motions in it.

    The other hypotheses move with the hand. The problem has a refined hand (``Problem.refinement``).
    """
    refinement = problem.refinement
    assert refinement is not None
    frames, nat = np.arange(len(problem.clip)), energy_of_nat(problem)
    T_input = refinement.seen.errors.tracked.T_cam_hand
    unrefined = replace(problem, clip=problem.clip.with_hand_at(T_input))
    terms = sum_energies(energy_of(unrefined), hand_evidence_energy(unrefined))(HAND_OBJECT_LEVEL_PX, frames)
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
    hand = SolvedHand(refinement.seen.errors.T_cam_hand(x), covariance, energy, refinement.seen.share(x))
    return hand, found.motion.core.concatenate(motion.take(np.arange(1, len(motion.poses().scale))))


def _motion_in_moving_hand(refinement: HandRefinement, motion: M, nat: float) -> MovingHand[M]:
    """Put a motion into the refined hand."""
    assumed = assumed_errors("estimated", refinement.joints)
    bias, jitter, (shared_depth, own_depth) = assumed.bias, assumed.jitter, HAND_DEPTH_SIGMAS_M
    constant = _concatenate_errors(bias, shared_depth, bias[SIZE_ERROR])
    prior = HandPrior.of(
        refinement.seen.errors.tracked, constant, _concatenate_errors(jitter, own_depth), HAND_PRIOR_WEIGHT * nat
    )
    size = refinement.shared[SIZE_ERROR] + refinement.own[:, SIZE_ERROR].mean()
    return replace(
        MovingHand.around(motion, prior),
        constant=_concatenate_errors(refinement.shared, 0.0, size)[None],
        own=np.stack([_concatenate_errors(errors, 0.0) for errors in refinement.own])[None],
    )


def _concatenate_errors(x: Float[ndarray, "P"], *others: float) -> Float[ndarray, "D"]:
    """Order errors as ``MovingHand`` does: shift, turn, shift along the ray, logarithm of the size."""
    return np.concatenate([x[TRANSLATION_ERRORS], x[ROTATION_ERRORS], others])


def _hand_errors(motion: MovingHand[M], refinement: HandRefinement) -> Float[ndarray, "N P"]:
    """Return the hand's errors in every frame as ``HandErrors`` orders them; the fingers stay as refined."""
    x, solved = refinement.shared + refinement.own, motion.constant[0, :-1] + motion.own[0]
    x[:, ROTATION_ERRORS], x[:, SIZE_ERROR] = solved[:, TURN_SLICE], motion.constant[0, -1]
    x[:, TRANSLATION_ERRORS] = solved[:, SHIFT_SLICE] + solved[:, RAY_SHIFT_INDEX, None] * motion.assumed.rays
    return x


def _covariance(motion: MovingHand[M], inverse: Float[ndarray, "8 8"]) -> Float[ndarray, "6 6"]:
    """Return the covariance of the shift and turn that all frames share, with the shift along the mean ray."""
    J = np.eye(6, 8)
    J[:3, RAY_SHIFT_INDEX] = motion.assumed.rays.mean(axis=0)
    return np.asarray(J @ inverse @ J.T)
