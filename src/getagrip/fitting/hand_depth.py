"""The hand's depth: how far along its viewing ray a hand was misplaced, which its own silhouette hardly tells.

A stable grasp tells it, and an object of known size, whose masks show its own depth. The object goes with the hand: one
that is put too near or too far carries it along another path, past the masks, and its fingertips miss the surface. So
the motion that was found is fitted again with the hand at some depths d, and the depth is that of the least

    E(d) / (SHARE E(0)) + 1/2 (d / SPREAD)^2

E leaves out push: fingers that are bent a little wrong reach into the object wherever the hand is, and the less, the
farther they are from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.methods import OnStage
from getagrip.fitting.methods.all_frames import result_of, search_of
from getagrip.fitting.motion import Hinge, Motion, Soft
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import minimise
from getagrip.geometry import se3

SPREAD = 0.02
"""Assumed standard deviation of the depth [m], that of no tracker in particular."""
SHARE = 0.12
"""An energy that rises by this share of itself counts as much as one against the prior."""
STEP, STEPS = 0.012, 3
"""Distance of the depths that are tried [m], and how many there are on either side."""
LEVEL, ITERATIONS = 128, 6
"""Resolution [px] and iterations of the fit at each."""
WORTH = 0.002
"""A hand that is off by less stays where it is [m]."""


def at_hand_depth(problem: Problem, found: MethodResult, on_stage: OnStage) -> tuple[Problem, MethodResult]:
    """The problem with its hand at the depth that explains the masks best, and the solutions fitted again there.

    Both as they are where the hand is, or where nothing tells its depth (``hand_depth``).
    """
    depth = hand_depth(problem, found)
    on_stage("hand's depth")
    if abs(depth) < WORTH:
        return problem, found
    assert isinstance(found.motion, Hinge | Soft)
    assert found.energy_of is not None
    where = f"{1e3 * abs(depth):.0f} mm {'farther from' if depth > 0.0 else 'nearer to'} the camera"
    there = deeper(problem, depth)
    there = replace(there, notes=(*problem.notes, f"the hand was put {where}, where a stable grasp explains the masks"))
    solution = search_of(there, on_stage).fine(found.motion, found.energy_of(there))
    motion = solution.motion
    return there, result_of(solution, motion.core if isinstance(motion, Soft) else motion, found.energy_of)


def hand_depth(problem: Problem, found: MethodResult) -> float:
    """How much farther from the camera the hand is than in the problem [m].

    0 unless the hand's pixels say that it was wrong, the object's size is known, and its motion has an axis: one that
    is free follows the masks whatever the hand's depth.
    """
    if not problem.hand_corrected or problem.clip.scale == "free" or found.axis is None or found.motion is None:
        return 0.0
    start: Motion = found.motion.take(np.zeros(1, int))
    here, start = _fitted(problem, found, start, 0.0)
    nearer, farther = _outwards(problem, found, start, -STEP), _outwards(problem, found, start, STEP)
    return least(np.array([*nearer[::-1], here, *farther]))


def least(energy: Float[ndarray, "n"]) -> float:
    """The depth of least cost [m], by the parabola through the best of the depths tried and its neighbours.

    ``energy`` is that of depths ``STEP`` apart, the middle one 0. Where one has none, the hand stays.
    """
    count = len(energy) // 2
    if not np.isfinite(energy).all() or energy[count] <= 0.0:
        return 0.0
    depth = STEP * np.arange(-count, count + 1)
    cost = energy / (SHARE * energy[count]) + 0.5 * (depth / SPREAD) ** 2
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    rise, bend = cost[k + 1] - cost[k - 1], cost[k - 1] - 2.0 * cost[k] + cost[k + 1]
    return float(depth[k] + STEP * np.clip(-0.5 * rise / bend, -1.0, 1.0)) if bend > 0.0 else float(depth[k])


def deeper(problem: Problem, depth: float) -> Problem:
    """The problem with its hand farther from the camera [m], in each frame along the ray through its middle."""
    hand = problem.clip.hand
    middle = se3.transform(hand.T_cam_hand, hand.vertices.mean(axis=(0, 1))[None])[:, 0]
    ray = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    return replace(problem, clip=problem.clip.with_hand_at(se3.rigid(None, depth * ray) @ hand.T_cam_hand))


def _outwards(problem: Problem, found: MethodResult, motion: Motion, step: float) -> list[float]:
    """The energies at depths farther and farther out, each fitted from the motion before."""
    energies = []
    for k in range(STEPS):
        energy, motion = _fitted(problem, found, motion, (k + 1) * step)
        energies.append(energy)
    return energies


def _fitted(problem: Problem, found: MethodResult, motion: Motion, depth: float) -> tuple[float, Motion]:
    """The energy without push and the motion, fitted with the hand at a depth."""
    assert found.energy_of is not None
    clip = deeper(problem, depth).clip
    terms = found.energy_of(replace(problem, clip=clip))(LEVEL, np.arange(len(clip)))
    solution = minimise(motion, [t for t in terms if t.name != "push"], clip.hand.T_cam_hand, ITERATIONS)
    return float(solution.energy[0]), solution.motion
