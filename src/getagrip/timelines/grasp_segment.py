"""A stable grasp: a soft hinge in the hand, searched once for itself and once with links to its neighbours.

A neighbour's pose that has been followed into the grasp is one more start of the second search, and what its link asks
for: where one segment has the object, the next should have it, but for a slip. All solutions of both searches count
afterwards: a wrong neighbour then cannot take the right one away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy import Energy, PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.smoothness import vertex_moments
from getagrip.fitting.every_frame import SolutionTrack, at_sampled_frames, extend_to_every_frame
from getagrip.fitting.hand_with_object import solve_with_hand
from getagrip.fitting.methods.all_frames import make_method_result, soft_energy, soft_hinges
from getagrip.fitting.motion import Hinge, Soft, transform_poses
from getagrip.fitting.objective import NO_TERMS, sum_energies
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import Solution, evaluate, minimise
from getagrip.geometry import se3
from getagrip.result import Axis, Status
from getagrip.timelines.following import Paths
from getagrip.timelines.footage import GraspClip
from getagrip.timelines.hypotheses import Hypotheses

COMPARISON_RESOLUTION_PX = 256
"""Resolution at which solutions are compared [px]."""
MAX_NEIGHBOUR_STARTS = 8
"""Paths of a neighbour's poses that the search begins with, too."""
N_FINAL_ITERATIONS = 6
"""Iterations of the last fit."""
LINK_WEIGHT = 0.03
"""Most that a link can cost, in areas of the object's mask times frames of the segment."""
LINK_SLIP_DIAMETERS = 0.08
"""Distance of the surface at which it costs half of that, in diameters: about 15 degrees."""


@dataclass(frozen=True)
class ExpectedPoses:
    """The object's pose in some frames of a segment, by a neighbouring segment's hypotheses, in the camera frame.

    Attributes:
        frames: the frames, of those that the segment's fit sees.
        R, centre: poses about the mesh's centre; the first axis is the neighbour's hypotheses.
        cost: (K,) energy of each hypothesis above the best.
    """

    frames: Int[ndarray, "m"]
    R: Float[ndarray, "K m 3 3"]
    centre: Float[ndarray, "K m 3"]
    cost: Float[ndarray, "K"]


@dataclass(frozen=True)
class LinkTerm:
    """``min over hypotheses k of cost_k + weight * d^2 / (d^2 + slip^2)``, in the frames of the link.

    d^2 is the mean squared distance of the object's vertices from where hypothesis k expects them. Beyond ``slip`` a
    larger distance costs little more: the object may have been turned in between, or the hypothesis lost.
    """

    moments: Float[ndarray, "4 4"]
    """Second moments of the vertices about the centre (``smoothness.moments``)."""
    expected: ExpectedPoses
    weight: float
    """Most that a link can cost in all its frames together [px^2]."""
    slip: float
    """[m]."""
    name: str = "link"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        at, found = self.expected.frames, Quadratic.zero(poses)
        if not len(at):
            return found
        points, share = self.moments[:, :3], self.moments[:, 3:]
        scale = poses.scale[:, None, None, None]
        arm = scale * points @ np.swapaxes(poses.R[:, at], -1, -2)
        placed = arm + share * poses.centre[:, at, None]
        arm_there = scale[:, None] * points @ np.swapaxes(self.expected.R, -1, -2)
        gap = placed[:, None] - arm_there - share * self.expected.centre[:, :, None]
        d2 = np.sum(gap**2, axis=(-2, -1))
        each = self.weight / len(at)
        cost = self.expected.cost + np.sum(each * d2 / (d2 + self.slip**2), axis=-1)
        best = np.argmin(cost, axis=1)
        b = np.arange(len(best))
        error, d2 = gap[b, best], d2[b, best]
        curvature = each * (self.slip / (d2 + self.slip**2)) ** 2
        J = np.empty((*error.shape, 7))
        J[..., :3], J[..., 3:6], J[..., 6] = share[..., None] * np.eye(3), -se3.hat(arm), arm - arm_there[b, best]
        J = J.reshape(*error.shape[:2], 12, 7)
        Jt = np.swapaxes(J, -1, -2)
        found.value[:, at] = self.expected.cost[best][:, None] / len(at) + each * d2 / (d2 + self.slip**2)
        found.g[:, at] = 2.0 * curvature[..., None] * (Jt @ error.reshape(*error.shape[:2], 12, 1))[..., 0]
        found.H[:, at] = 2.0 * curvature[..., None, None] * (Jt @ J)
        return found


@dataclass(frozen=True)
class Neighbour:
    """The object's pose in some frames of a grasp's problem, by the followed hypotheses of a neighbouring segment."""

    paths: Paths
    frames: Int[ndarray, "m"]
    """Rising indices of the problem's frames."""
    earlier: bool
    """True if the neighbour comes before the grasp."""


@dataclass(frozen=True)
class GraspSolutions:
    """Solutions of a grasp at the frames of its problem."""

    grasp: GraspClip
    problem: Problem
    """At the frames that are fitted together."""
    sampled: Int[ndarray, "m"]
    """These frames, of the timeline."""
    motion: Soft[Hinge]
    energy: Float[ndarray, "K"]
    """Without links."""

    @property
    def hypotheses(self) -> Hypotheses:
        """In the world, at the problem's frames."""
        poses = transform_poses(self.motion.poses(), _T_world_hand(self.problem))
        return Hypotheses(poses.R, poses.centre, poses.scale, self.energy)


def solve_grasp(grasp: GraspClip, problem: Problem, neighbours: Sequence[Neighbour]) -> GraspSolutions:
    """Search for the solutions of a grasp, by its problem. Raises ``GetagripError`` where nothing can be rendered."""
    found = soft_hinges(problem, lambda _: None)
    motion = found.motion
    if neighbours:
        starts = [_starts_from_neighbour(problem, neighbour) for neighbour in neighbours]
        begun = replace(problem, prior_poses=np.concatenate([*starts, problem.prior_poses]))
        linked = soft_hinges(begun, lambda _: None, link_energy(problem, neighbours))
        motion = motion.concatenate(replace(linked.motion, ridge=motion.ridge))
    terms, N = soft_energy(problem)(COMPARISON_RESOLUTION_PX, np.arange(len(problem.clip))), len(motion.deviation)
    cost = evaluate(motion, terms, problem.clip.hand.T_cam_hand, np.full(N, np.inf)).cost
    order = np.argsort(cost, kind="stable")  # all of them: a box turned by half is the same, but for its links
    sampled = grasp.rows[grasp.clip.index_of(problem.clip.frames)]
    return GraspSolutions(grasp, problem, sampled, motion.take(order), cost[order])


@dataclass(frozen=True)
class GraspTrack:
    """A grasp in all of its frames in which its hand is known."""

    solutions: GraspSolutions
    chosen: int
    """Which of its solutions."""
    found: MethodResult
    """That, fitted once more with its links, at the problem's frames."""
    track: SolutionTrack
    """That, in all frames."""

    @property
    def axis(self) -> Axis | None:
        """Its axis, with the angles in all frames."""
        axis, angle = self.found.axis, self.track.angle
        return None if axis is None or angle is None else replace(axis, angle=angle)


def fit_in_all_frames(solutions: GraspSolutions, k: int, neighbours: Sequence[Neighbour]) -> GraspTrack:
    """Fit solution k once more with its links, in every frame; an estimated hand is solved with it."""
    motion, hand = solutions.motion.take(np.array([k])), None
    if solutions.problem.refinement is not None:
        hand, motion = solve_with_hand(solutions.problem, motion, lambda some: linked_energy(some, neighbours))
        solutions = replace(solutions, problem=solutions.problem.with_hand(hand))
    energy = {"total": solutions.energy[[k]]}
    solution = Solution(motion, solutions.energy[[k]], energy, [Status.FINISHED], 0)
    grasp, problem, found = solutions.grasp, solutions.problem, make_method_result(solution, motion.core, soft_energy)
    if neighbours or hand is not None:
        found = replace(_refit_with_links(problem, found, neighbours), hand=hand)
    sampled = at_sampled_frames(problem, found)
    return GraspTrack(solutions, k, found, extend_to_every_frame(grasp.clip, problem, found, sampled))


def _refit_with_links(problem: Problem, found: MethodResult, neighbours: Sequence[Neighbour]) -> MethodResult:
    """Fitted again, links included."""
    assert isinstance(found.motion, Soft)
    terms = linked_energy(problem, neighbours)(COMPARISON_RESOLUTION_PX, np.arange(len(problem.clip)))
    solution = minimise(found.motion, terms, problem.clip.hand.T_cam_hand, N_FINAL_ITERATIONS)
    return make_method_result(solution, solution.motion.core, soft_energy)


def linked_energy(problem: Problem, neighbours: Sequence[Neighbour]) -> Energy:
    """Return the energy of a grasp with its links."""
    return sum_energies(soft_energy(problem), link_energy(problem, neighbours))


def link_energy(problem: Problem, neighbours: Sequence[Neighbour]) -> Energy:
    """Return the energy of the links of a grasp."""
    return sum_energies(*(_link_terms(problem, neighbour) for neighbour in neighbours)) if neighbours else NO_TERMS


def max_link_cost(problem: Problem) -> float:
    """Return the most that a link to a problem can cost [px^2]."""
    return LINK_WEIGHT * float(problem.observation.area.mean()) * len(problem.clip)


def _link_terms(problem: Problem, neighbour: Neighbour) -> Energy:
    clip, frames, expected = problem.clip, neighbour.frames, neighbour.paths.found
    assert clip.world is not None
    seen = transform_poses(expected, se3.inverse(clip.world.T_world_cam[frames]))
    of, size = vertex_moments(clip.mesh.vertices - clip.mesh.centre), LINK_SLIP_DIAMETERS * clip.mesh.diameter
    cost = expected.energy - expected.energy.min()

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
        share = len(index) / len(clip)
        here = np.flatnonzero(np.isin(frames, index))
        known = ExpectedPoses(np.searchsorted(index, frames[here]), seen.R[:, here], seen.centre[:, here], share * cost)
        return [LinkTerm(of, known, share * max_link_cost(problem), size)]

    return terms


def _starts_from_neighbour(problem: Problem, neighbour: Neighbour) -> Float[ndarray, "k 4 4"]:
    """``T_hand_obj`` as the neighbour has it in the first and in the last of its frames."""
    T_world_obj = neighbour.paths.found.T_world_obj(problem.clip.mesh.centre)[:MAX_NEIGHBOUR_STARTS]
    T_hand_world = se3.inverse(_T_world_hand(problem)[neighbour.frames])
    return np.concatenate([T_hand_world[n] @ T_world_obj[:, n] for n in (0, -1)])


def _T_world_hand(problem: Problem) -> Float[ndarray, "n 4 4"]:
    clip = problem.clip
    assert clip.world is not None
    return np.asarray(clip.world.T_world_cam @ clip.hand.T_cam_hand)
