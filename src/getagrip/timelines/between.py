"""The object between two segments: followed from both of them, and fitted to each frame's mask.

The motions from the one, from the other and a blend of both are fitted; that of the least energy is taken. A blend of
two that disagree, as where a box was turned over unseen, is no motion.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.fitting.energy.smoothness import SmoothnessTerm, TermInFrame, vertex_moments
from getagrip.fitting.motion import Free
from getagrip.fitting.objective import object_evidence_energy
from getagrip.fitting.problem import Problem
from getagrip.fitting.solve import minimise
from getagrip.geometry import se3
from getagrip.timelines.following import track_hypotheses
from getagrip.timelines.footage import TimelineInputs
from getagrip.timelines.hypotheses import Hypotheses
from getagrip.timelines.motion import TimelineMotion

WORLD_SMOOTHNESS_WEIGHT = 2e5
"""Energy of a surface that moves from one frame to the next [px^2 / m^2]: 20 for a centimetre."""
GAP_FIT_STAGES = ((128, 6), (256, 4))
"""Resolution [px] and iterations."""


def world_smoothness_term(problem: Problem) -> TermInFrame:
    """Make the term by which the object's surface moves little in the world from each of the frames to the next."""
    mesh, world = problem.clip.mesh, problem.clip.world
    assert world is not None
    return TermInFrame(
        SmoothnessTerm(vertex_moments(mesh.vertices - mesh.centre), WORLD_SMOOTHNESS_WEIGHT), world.T_world_cam
    )


def fill_gaps(motion: TimelineMotion, footage: TimelineInputs, known: list[Segment]) -> None:
    """Fill the frames between segments that are known, and before and after them."""
    edges = [(None, known[0]), *itertools.pairwise(known), (known[-1], None)]
    for one, other in edges:
        rows = np.arange(0 if one is None else one.last + 1, len(footage) if other is None else other.first)
        if not len(rows):
            continue
        ahead = None if one is None else track_hypotheses(footage, one.last, rows, motion.at(one.last)).found
        behind = (
            None if other is None else track_hypotheses(footage, other.first, rows[::-1], motion.at(other.first)).found
        )
        behind = behind and behind.at(np.arange(len(rows))[::-1])
        found, shown = _candidate_motions(ahead, behind), footage.shown[rows]
        if shown.sum() > 1:
            found = _fit_smooth_motion(footage.problem(rows[shown]), np.flatnonzero(shown), found)
        else:
            found = found.take(np.array([-1]))
        motion.put(rows, found, "fitted")


def _candidate_motions(ahead: Hypotheses | None, behind: Hypotheses | None) -> Hypotheses:
    """Return the motions that are known; of two, the blend of the best as well."""
    if ahead is None or behind is None:
        start = ahead or behind
        assert start is not None
        return start
    best = np.zeros(1, int)
    return ahead.concatenate(behind).concatenate(_blend_motions(ahead.take(best), behind.take(best)))


def _blend_motions(ahead: Hypotheses, behind: Hypotheses) -> Hypotheses:
    """From the one to the other, evenly in time: rotations along the shortest path, centres on a line."""
    n = ahead.R.shape[1]
    share = (np.arange(n) + 1.0)[:, None] / (n + 1)
    turn = se3.log_so3(behind.R @ np.swapaxes(ahead.R, -1, -2))
    R = se3.exp_so3(share * turn) @ ahead.R
    return Hypotheses(R, ahead.centre + share * (behind.centre - ahead.centre), ahead.scale, ahead.energy)


def _fit_smooth_motion(problem: Problem, at: Int[ndarray, "m"], start: Hypotheses) -> Hypotheses:
    """Fit the best smooth motion near these that meets the masks; the problem is at the frames ``at`` of theirs."""
    world = problem.clip.world
    assert world is not None
    motion = Free(start.R[:, at], start.centre[:, at], np.log(start.scale))
    energy, smooth = object_evidence_energy(problem), world_smoothness_term(problem)
    everywhere, T_cam_world = np.arange(len(at)), se3.inverse(world.T_world_cam)
    for level, iterations in GAP_FIT_STAGES:
        found = minimise(motion, [*energy(level, everywhere), smooth], T_cam_world, iterations)
        motion = found.motion
    poses = motion.poses()
    R, centre = start.R.copy(), start.centre.copy()
    R[:, at], centre[:, at] = poses.R, poses.centre
    return Hypotheses(R, centre, start.scale, found.energy).take(np.array([np.argmin(found.energy)]))
