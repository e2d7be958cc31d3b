"""A stable grasp: a soft hinge in the hand, searched once for itself and once with links to its neighbours.

A neighbour's pose that has been followed into the grasp is one more start of the second search, and what its link asks
for. All solutions of both count afterwards: a wrong neighbour then cannot take the right one away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.fitting.energy import Energy, Term
from getagrip.fitting.energy.smoothness import moments
from getagrip.fitting.every_frame import at_every_frame, at_sampled_frames
from getagrip.fitting.methods.all_frames import result_of, soft_energy, soft_hinges
from getagrip.fitting.motion import Hinge, Soft
from getagrip.fitting.objective import NOTHING, plus
from getagrip.fitting.problem import MethodResult, Problem, prepare
from getagrip.fitting.solve import Solution, evaluate, minimise
from getagrip.geometry import se3
from getagrip.result import Axis, FrameKind, Status
from getagrip.timelines.following import Paths
from getagrip.timelines.footage import Footage
from getagrip.timelines.hypotheses import Hypotheses, in_world
from getagrip.timelines.link_term import SLIP, WEIGHT, Expected, LinkTerm

FINEST = 256
"""Resolution at which solutions are compared [px]."""
STARTS = 8
"""Paths of a neighbour's poses that the search begins with, too."""
POLISH = 6
"""Iterations of the last fit."""


@dataclass(frozen=True)
class Neighbour:
    """Where the hypotheses of a neighbouring segment, followed, have the object in some frames of a grasp's problem."""

    paths: Paths
    frames: Int[ndarray, "m"]
    """Of the problem's frames, rising."""
    earlier: bool
    """Whether the neighbour comes before the grasp."""


@dataclass(frozen=True)
class GraspSolutions:
    """Solutions of a grasp at the frames of its problem."""

    segment: Segment
    problem: Problem
    rows: Int[ndarray, "n"]
    """The problem's frames in the clip."""
    motion: Soft[Hinge]
    energy: Float[ndarray, "K"]
    """Without links."""

    @property
    def hypotheses(self) -> Hypotheses:
        """In the world, at the problem's frames."""
        poses, T = self.motion.poses(), _T_world_hand(self.problem)
        return in_world(poses.R, poses.centre, poses.scale, self.energy, T)


def prepared(footage: Footage, segment: Segment) -> Problem | None:
    """The problem of a grasp; None where its hand is not known or fewer than two frames show the object."""
    grasp = footage.grasp_clip(segment)
    return None if grasp is None else prepare(grasp[0], grasp[1], footage.options)


def solved(footage: Footage, segment: Segment, problem: Problem, neighbours: Sequence[Neighbour]) -> GraspSolutions:
    """The solutions of a grasp. Raises ``GetagripError`` where nothing can be rendered."""
    found = soft_hinges(problem, lambda _: None)
    motion = found.motion
    if neighbours:
        starts = [_starts(problem, neighbour) for neighbour in neighbours]
        begun = replace(problem, prior_poses=np.concatenate([*starts, problem.prior_poses]))
        linked = soft_hinges(begun, lambda _: None, links_of(problem, neighbours))
        motion = motion.concatenate(replace(linked.motion, ridge=motion.ridge))
    terms, N = soft_energy(problem)(FINEST, np.arange(len(problem.clip))), len(motion.deviation)
    cost = evaluate(motion, terms, problem.clip.hand.T_cam_hand, np.full(N, np.inf)).cost
    order = np.argsort(cost, kind="stable")  # all of them: a box turned by half is the same, but for its links
    rows = footage.clip.index_of(problem.clip.frames)
    return GraspSolutions(segment, problem, rows, motion.take(order), cost[order])


@dataclass(frozen=True)
class GraspTrack:
    """A grasp in all of its frames in which its hand is known."""

    grasp: GraspSolutions
    chosen: int
    """Which of its solutions."""
    found: MethodResult
    """That, fitted once more with its links, at the problem's frames."""
    rows: Int[ndarray, "n"]
    T_cam_hand: Float[ndarray, "n 4 4"]
    T_hand_obj: Float[ndarray, "n 4 4"]
    kind: tuple[FrameKind, ...]
    axis: Axis | None
    notes: tuple[str, ...]


def in_all_frames(footage: Footage, grasp: GraspSolutions, k: int, neighbours: Sequence[Neighbour]) -> GraspTrack:
    """Solution k, fitted once more with its links, in every frame."""
    motion = grasp.motion.take(np.array([k]))
    energy = {"total": grasp.energy[[k]]}
    solution = Solution(motion, grasp.energy[[k]], energy, [Status.FINISHED], 0)
    problem, found = grasp.problem, result_of(solution, motion.core, soft_energy)
    if neighbours:
        found = _polished(problem, found, neighbours)
    value = footage.grasp_clip(grasp.segment)
    assert value is not None
    clip, masks, rows = value
    track = at_every_frame(clip, masks, problem, found, at_sampled_frames(problem, found))
    axis = None if found.axis is None or track.angle is None else replace(found.axis, angle=track.angle)
    return GraspTrack(grasp, k, found, rows, track.T_cam_hand, track.T_hand_obj[0], track.kind, axis, problem.notes)


def _polished(problem: Problem, found: MethodResult, neighbours: Sequence[Neighbour]) -> MethodResult:
    """Fitted again, links included."""
    assert isinstance(found.motion, Soft)
    energy = plus(soft_energy(problem), links_of(problem, neighbours))
    terms = energy(FINEST, np.arange(len(problem.clip)))
    solution = minimise(found.motion, terms, problem.clip.hand.T_cam_hand, POLISH)
    return result_of(solution, solution.motion.core, soft_energy)


def links_of(problem: Problem, neighbours: Sequence[Neighbour]) -> Energy:
    """The energy of the links of a grasp."""
    return plus(*(_link(problem, neighbour) for neighbour in neighbours)) if neighbours else NOTHING


def most(problem: Problem) -> float:
    """The most that a link to a problem can cost [px^2]."""
    return WEIGHT * float(problem.observation.area.mean()) * len(problem.clip)


def _link(problem: Problem, neighbour: Neighbour) -> Energy:
    """The energy of one link."""
    clip, frames, expected = problem.clip, neighbour.frames, neighbour.paths.found
    assert clip.world is not None
    R, centre = expected.seen_from(se3.inverse(clip.world.T_world_cam[frames]))
    of, size = moments(clip.mesh.vertices - clip.mesh.centre), SLIP * clip.mesh.diameter
    cost = expected.energy - expected.energy.min()

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
        share = len(index) / len(clip)
        here = np.flatnonzero(np.isin(frames, index))
        known = Expected(np.searchsorted(index, frames[here]), R[:, here], centre[:, here], share * cost)
        return [LinkTerm(of, known, share * most(problem), size)]

    return terms


def _starts(problem: Problem, neighbour: Neighbour) -> Float[ndarray, "k 4 4"]:
    """``T_hand_obj`` as the neighbour has it in the first and in the last of its frames."""
    T_world_obj = neighbour.paths.found.T_world_obj(problem.clip.mesh.centre)[:STARTS]
    T_hand_world = se3.inverse(_T_world_hand(problem)[neighbour.frames])
    return np.concatenate([T_hand_world[n] @ T_world_obj[:, n] for n in (0, -1)])


def _T_world_hand(problem: Problem) -> Float[ndarray, "n 4 4"]:
    clip = problem.clip
    assert clip.world is not None
    return np.asarray(clip.world.T_world_cam @ clip.hand.T_cam_hand)
