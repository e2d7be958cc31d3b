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
from getagrip.fitting.hand_errors import SHIFT, SIZE, TURN
from getagrip.fitting.hand_refinement import HandRefinement, assumed_errors
from getagrip.fitting.motion import HandPrior, Motion, MovingHand, moving_hand
from getagrip.fitting.objective import energy_of_nat, evidence_on_hand, plus
from getagrip.fitting.problem import EnergyOf, Problem
from getagrip.fitting.solve import evaluate, inverse_of_shared, minimise
from getagrip.fitting.solved_hand import SolvedHand

M = TypeVar("M", bound=Motion)

DEPTH = 0.018, 0.007
"""Standard deviations of the error along the camera's ray beside that in any direction: that all frames share, and of
each frame's own [m]; those of estimates from images (docs/datasets.md)."""
PRIOR = 0.5
"""Weight of the prior against what it has in the hand's refinement: clips differ in how far their hands are off, so
that its tails are heavier than a square's. Chosen on training clips."""
TAIL = 2.0
"""Degrees of freedom of Student's t: a clip's shift, turn and depth may each be off by more than is assumed."""
LEVEL, ITERATIONS, AGAIN = 128, 8, (4, 4)
"""Resolution [px]; most iterations, and those of each round under a prior that is as wide as the errors before."""


def solve_with_hand(problem: Problem, motion: M, energy_of: EnergyOf) -> tuple[SolvedHand, M]:
    """Solve the first hypothesis together with the hand; return the hand, and the motions in it.

    The other hypotheses go with the hand. The hand of the problem was refined (``Problem.refinement``).
    """
    refinement = problem.refinement
    assert refinement is not None
    given, nat = problem.with_input_hand(), energy_of_nat(problem)
    frames, T_input = np.arange(len(given.clip)), given.clip.hand.T_cam_hand
    terms = plus(energy_of(given), evidence_on_hand(given))(LEVEL, frames)
    start = _moving(refinement, motion.take(np.zeros(1, int)), nat)
    found = minimise(start, terms, T_input, ITERATIONS)
    for iterations in AGAIN:
        assumed = start.assumed.widened(found.motion.constant[0], found.motion.own[0], TAIL)
        found = minimise(replace(found.motion, assumed=assumed), terms, T_input, iterations)
    x = _errors(found.motion, refinement)
    begun = evaluate(start, terms, T_input, np.full(1, np.inf)).values[0]
    names = [term.name for term in terms if isinstance(term, OnHand)]
    before = dict(zip((term.name for term in terms), begun, strict=False))
    energy = {name: (float(before[name]), float(found.terms[name][0])) for name in names}
    covariance = nat * _covariance(found.motion, inverse_of_shared(found.motion, terms, T_input, last=8))
    rest = np.arange(1, len(motion.poses().scale))
    seen = refinement.seen
    hand = SolvedHand(seen.errors.T_cam_hand(x), covariance, energy, seen.share(x))
    return hand, found.motion.core.concatenate(motion.take(rest))


def _moving(refinement: HandRefinement, motion: M, nat: float) -> MovingHand[M]:
    """Put a motion into the refined hand."""
    assumed = assumed_errors("estimated", refinement.joints)
    hand, bias, jitter = refinement.seen.errors.tracked, assumed.bias, assumed.jitter
    constant = np.concatenate([bias[SHIFT], bias[TURN], [DEPTH[0], bias[SIZE]]])
    own = np.concatenate([jitter[SHIFT], jitter[TURN], [DEPTH[1]]])
    a, b = refinement.shared, refinement.own
    return replace(
        MovingHand.around(motion, HandPrior.of(hand, constant, own, PRIOR * nat)),
        constant=np.concatenate([a[SHIFT], a[TURN], [0.0, a[SIZE] + b[:, SIZE].mean()]])[None],
        own=np.concatenate([b[:, SHIFT], b[:, TURN], np.zeros((len(b), 1))], axis=1)[None],
    )


def _errors(motion: MovingHand[M], refinement: HandRefinement) -> Float[ndarray, "N P"]:
    """Return the errors of the hand in every frame, as ``HandErrors`` has them; fingers stay as they were refined."""
    x, solved = refinement.shared + refinement.own, motion.constant[0, :-1] + motion.own[0]
    x[:, TURN], x[:, SIZE] = solved[:, moving_hand.TURN], motion.constant[0, -1]
    x[:, SHIFT] = solved[:, moving_hand.SHIFT] + solved[:, moving_hand.DEPTH, None] * motion.assumed.rays
    return x


def _covariance(motion: MovingHand[M], inverse: Float[ndarray, "8 8"]) -> Float[ndarray, "6 6"]:
    """Return the part of shift and turn that all frames share, the mean ray's among them."""
    J = np.eye(6, 8)
    J[:3, moving_hand.DEPTH] = motion.assumed.rays.mean(axis=0)
    return np.asarray(J @ inverse @ J.T)
