"""Hand and object solved together: by all evidence on either, and the contact between them.

The hand's own pixels have refined it before (``hand_refinement``), whatever it holds. Here its errors are parameters
beside the object's motion (``MovingHand``), under the same prior: what is known of the object tells of the hand, and
the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.fitting.energy import Energy
from getagrip.fitting.hand_errors import BENDS, RIGID, SHIFT, SIZE, TURN, HandErrors
from getagrip.fitting.hand_refinement import ASSUMED, HandRefinement
from getagrip.fitting.motion import HandPrior, Motion, MovingHand
from getagrip.fitting.motion import moving_hand as moving
from getagrip.fitting.objective import energy_of_nat, evidence_on_hand, plus
from getagrip.fitting.problem import EnergyOf, Problem
from getagrip.fitting.solve import Solution, minimise
from getagrip.geometry import se3

M = TypeVar("M", bound=Motion)

DEPTH_BIAS, DEPTH_JITTER = 0.018, 0.007
LEVEL, ITERATIONS = 128, 8


def solve_with_hand(problem: Problem, motion: M, energy_of: EnergyOf, iterations: int = ITERATIONS):
    refinement = problem.refinement
    given = problem.at_given_hand()
    hand, frames = given.clip.hand, np.arange(len(given.clip))
    energy = plus(energy_of(given), evidence_on_hand(given))
    start = moving_hand(problem.refinement, motion, energy_of_nat(problem))
    found = minimise(start, energy(LEVEL, frames), hand.T_cam_hand, iterations, threads=problem.threads)
    return found


def moving_hand(refinement: HandRefinement, motion: M, weight: float) -> MovingHand[M]:
    hand = refinement.seen.errors.tracked
    bias, jitter = ASSUMED.bias, ASSUMED.jitter
    constant = np.concatenate([bias[SHIFT], bias[TURN], [DEPTH_BIAS], [bias[SIZE]]])
    own = np.concatenate([jitter[SHIFT], jitter[TURN], [DEPTH_JITTER]])
    start = MovingHand.around(motion, HandPrior.of(hand, constant, own, weight))
    a, b = refinement.shared, refinement.own
    B = len(start.constant)
    zero, N = np.zeros(1), len(b)
    first = np.concatenate([a[SHIFT], a[TURN], zero, [a[SIZE] + b[:, SIZE].mean()]])
    each = np.concatenate([b[:, SHIFT], b[:, TURN], np.zeros((N, 1))], axis=1)
    return replace(start, constant=np.tile(first, (B, 1)), own=np.tile(each, (B, 1, 1)))
