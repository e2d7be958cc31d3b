"""Segments solved by themselves: a grasp as a soft hinge in the hand, a static segment as one pose in the world.

A grasp is searched twice, without and with links to its neighbours. A neighbour's poses, tracked into the grasp, are
further starts of the second search, and its link pulls the poses towards them, up to a slip. Solutions of both searches
are kept, so that a wrong neighbour cannot displace the right solution.

A static segment is fitted to the masks alone: hands neither help nor disturb. A static camera sees a single silhouette,
through passing hands: depth comes from the object's size, and from the support plane where it is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.clip.clip import frame_indices
from getagrip.fitting.energy import Energy, PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.homan_terms import vertex_moments
from getagrip.fitting.hand.joint_hand_object import solve_with_hand
from getagrip.fitting.methods.all_frames import make_method_result, soft_energy, soft_hinges
from getagrip.fitting.motion import Fixed, Hinge, Soft, transform_poses
from getagrip.fitting.objective import NO_TERMS, object_evidence_energy, sum_energies
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.search import DEFAULT_SCHEDULE, Search
from getagrip.fitting.solver.solve import Solution, evaluate, minimise
from getagrip.fitting.stages.remaining_frames import SolutionTrack, at_sampled_frames, extend_to_every_frame
from getagrip.geometry import camera, se3
from getagrip.result import Axis, Status
from getagrip.timelines.observations import GraspClip, Hypotheses
from getagrip.timelines.tracking import Paths

COMPARISON_RESOLUTION_PX = 256
"""Resolution of the masks by which solutions are compared [px]."""
MAX_NEIGHBOUR_STARTS = 8
"""Maximum number of a neighbour's paths that are start poses of the search."""
N_FINAL_ITERATIONS = 6
"""Iterations of the final fit."""
LINK_WEIGHT = 0.03
"""Maximum cost of a link, as a fraction of the object's mask area times the segment's number of frames."""
LINK_SLIP_DIAMETERS = 0.08
"""Surface distance at which a link costs half its maximum [diameters]: about 15 degrees."""
N_STATIC_FRAMES = 8
"""Number of frames of a static segment that are fitted, since all show nearly the same."""
SUPPORT_WEIGHT = 0.01
"""Energy of an object that floats at ``FLOATING_HEIGHT_M``, as a fraction of the mean mask area."""
FLOATING_HEIGHT_M = 0.01
"""Height over the support plane at that energy [m]."""
MAX_ENERGY_RATIO = 1.5
"""Multiple of the least energy above which solutions are dropped."""


@dataclass(frozen=True)
class ExpectedPoses:
    """Poses of the object in some frames of a segment, expected by a neighbour's hypotheses, in the camera frame.

    Attributes:
        frames: indices into the frames of the segment's fit.
        R, centre: poses about the mesh's centre; the first axis counts the neighbour's hypotheses.
        cost: (K,) energy of each hypothesis above the best one [px^2].
    """

    frames: Int[ndarray, "m"]
    R: Float[ndarray, "K m 3 3"]
    centre: Float[ndarray, "K m 3"]
    cost: Float[ndarray, "K"]


@dataclass(frozen=True)
class LinkTerm:
    """``min over hypotheses k of cost_k + weight * d^2 / (d^2 + slip^2)``, in the frames of the link.

    d^2 is the mean squared distance of the object's vertices from hypothesis k. Beyond ``slip`` larger distances cost
    little more: the object may have been turned in between, or tracking may have lost the hypothesis.
    """

    moments: Float[ndarray, "4 4"]
    """Second moments of the vertices about the centre (``vertex_moments``)."""
    expected: ExpectedPoses
    weight: float
    """Maximum cost of the link, summed over its frames [px^2]."""
    slip: float
    """Distance at half of the maximum cost [m]."""
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
    """The tracked hypotheses of a neighbouring segment, in some frames of a grasp's problem."""

    paths: Paths
    frames: Int[ndarray, "m"]
    """Indices of the problem's frames, ascending."""
    earlier: bool
    """True if the neighbour precedes the grasp."""


@dataclass(frozen=True)
class GraspSolutions:
    """Solutions of a grasp at the frames of its problem."""

    grasp: GraspClip
    problem: Problem
    """The problem at the sampled frames."""
    sampled: Int[ndarray, "m"]
    """Indices of the sampled frames in the timeline."""
    motion: Soft[Hinge]
    energy: Float[ndarray, "K"]
    """Energy of each solution without links [px^2]."""

    @property
    def hypotheses(self) -> Hypotheses:
        """The solutions in the world frame, at the sampled frames."""
        poses = transform_poses(self.motion.poses(), _T_world_hand(self.problem))
        return Hypotheses(poses.R, poses.centre, poses.scale, self.energy)


def solve_grasp(grasp: GraspClip, problem: Problem, neighbours: Sequence[Neighbour]) -> GraspSolutions:
    """Search for the solutions of a grasp. Raises ``GetagripError`` where nothing can be rendered."""
    found = soft_hinges(problem, lambda _: None)
    motion = found.motion
    if neighbours:
        starts = [_starts_from_neighbour(problem, neighbour) for neighbour in neighbours]
        begun = replace(problem, prior_poses=np.concatenate([*starts, problem.prior_poses]))
        linked = soft_hinges(begun, lambda _: None, link_energy(problem, neighbours))
        motion = motion.concatenate(replace(linked.motion, ridge=motion.ridge))
    terms, N = soft_energy(problem)(COMPARISON_RESOLUTION_PX, np.arange(len(problem.clip))), len(motion.deviation)
    cost = evaluate(motion, terms, problem.clip.hand.T_cam_hand, np.full(N, np.inf)).cost
    order = np.argsort(cost, kind="stable")  # all are kept: symmetric poses have equal masks, but different links
    sampled = grasp.rows[grasp.clip.index_of(problem.clip.frames)]
    return GraspSolutions(grasp, problem, sampled, motion.take(order), cost[order])


@dataclass(frozen=True)
class GraspTrack:
    """A grasp's chosen solution, in all frames in which its hand is known."""

    solutions: GraspSolutions
    chosen: int
    """Index of the chosen solution."""
    found: MethodResult
    """The chosen solution, refitted with its links, at the sampled frames."""
    track: SolutionTrack
    """The refitted solution in all frames."""

    @property
    def axis(self) -> Axis | None:
        """The grasp's axis, with the angle of every frame."""
        axis, angle = self.found.axis, self.track.angle
        return None if axis is None or angle is None else replace(axis, angle=angle)


def fit_in_all_frames(solutions: GraspSolutions, k: int, neighbours: Sequence[Neighbour]) -> GraspTrack:
    """Fit solution k again with its links, and extend it to every frame; an estimated hand is solved jointly."""
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
    assert isinstance(found.motion, Soft)
    terms = linked_energy(problem, neighbours)(COMPARISON_RESOLUTION_PX, np.arange(len(problem.clip)))
    solution = minimise(found.motion, terms, problem.clip.hand.T_cam_hand, N_FINAL_ITERATIONS)
    return make_method_result(solution, solution.motion.core, soft_energy)


def linked_energy(problem: Problem, neighbours: Sequence[Neighbour]) -> Energy:
    """Return the energy of a grasp and of its links."""
    return sum_energies(soft_energy(problem), link_energy(problem, neighbours))


def link_energy(problem: Problem, neighbours: Sequence[Neighbour]) -> Energy:
    """Return the energy of the links of a grasp."""
    return sum_energies(*(_link_terms(problem, neighbour) for neighbour in neighbours)) if neighbours else NO_TERMS


def max_link_cost(problem: Problem) -> float:
    """Return the maximum cost of a link to a problem [px^2]."""
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
    """``T_hand_obj`` by the neighbour's paths, in the first and in the last of its frames."""
    T_world_obj = neighbour.paths.found.T_world_obj(problem.clip.mesh.centre)[:MAX_NEIGHBOUR_STARTS]
    T_hand_world = se3.inverse(_T_world_hand(problem)[neighbour.frames])
    return np.concatenate([T_hand_world[n] @ T_world_obj[:, n] for n in (0, -1)])


def _T_world_hand(problem: Problem) -> Float[ndarray, "n 4 4"]:
    clip = problem.clip
    assert clip.world is not None
    return np.asarray(clip.world.T_world_cam @ clip.hand.T_cam_hand)


def select_static_frames(segment: Segment, shown: Bool[ndarray, "T"]) -> Int[ndarray, "n"]:
    """Choose the fitted frames of a static segment; none where fewer than two show the object."""
    seen = segment.rows[shown[segment.rows]]
    return seen[frame_indices(len(seen), N_STATIC_FRAMES)] if len(seen) > 1 else seen[:0]


def static_hypotheses(problem: Problem, frames: int, support: bool, start: Hypotheses | None = None) -> Hypotheses:
    """Search for one pose of a static segment of ``frames`` frames, by the problem at some of them.

    ``start`` holds further start poses, of its first frame. ``support`` adds the energy of the support plane.
    Raises ``GetagripError`` where nothing can be rendered.
    """
    assert problem.clip.world is not None
    T_cam_world = se3.inverse(problem.clip.world.T_world_cam)
    energy = object_evidence_energy(problem)
    if support:
        energy = sum_energies(energy, support_energy(problem))
    search = Search(T_cam_world, problem.surface, DEFAULT_SCHEDULE, lambda _: None)
    found = search.run(search.relax(static_initial_poses(problem, start), energy).core, energy)
    best = found.take(np.flatnonzero(found.energy <= MAX_ENERGY_RATIO * found.energy[0]))
    poses = replace(best.motion, frames=frames).poses()
    return Hypotheses(poses.R, poses.centre, poses.scale, best.energy)


def support_energy(problem: Problem) -> Energy:
    """Return the energy of the object's height over the support plane; zero where the plane is unknown."""
    clip = problem.clip
    world = clip.world
    if world is None or world.up is None or world.support is None:
        return sum_energies()
    normal, height = plane_in_camera(world.T_world_cam, world.up, world.support)
    vertices = hull_vertices(clip.mesh.vertices - clip.mesh.centre)
    weight = SUPPORT_WEIGHT * float(problem.observation.area.mean()) / FLOATING_HEIGHT_M**2

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
        return [SupportTerm(vertices, normal[index], height[index], weight)]

    return terms


def static_initial_poses(problem: Problem, start: Hypotheses | None) -> Fixed:
    """Return the poses of ``start``, then uniform rotations on the ray through the first mask.

    Their distance follows from the mask's size; with a free scale it is the hand's mean distance.
    """
    clip, inits = problem.clip, problem.options.inits
    assert clip.world is not None
    T_world_cam = clip.world.T_world_cam[0]
    R = se3.super_fibonacci(inits if start is None else inits - len(start.R))
    box = camera.bounding_boxes(problem.masks.object[:1])[0].astype(float)
    in_camera = (clip.mesh.vertices - clip.mesh.centre) @ np.swapaxes(T_world_cam[:3, :3].T @ R, -1, -2)
    extent = np.ptp(in_camera[..., :2], axis=1).max(axis=-1)
    seen = float(np.max(box[2:] - box[:2])) / clip.K[0, 0, 0]
    depth, log_scale = extent / seen, np.zeros(len(R))
    if clip.scale == "free":
        hand = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices).mean(axis=(0, 1))[2]
        depth, log_scale = np.full(len(R), hand), np.log(hand / depth)
    ray = camera.backproject(clip.K[:1], ((box[:2] + box[2:]) / 2.0)[None, None])[0, 0]
    centre = se3.transform(T_world_cam, depth[:, None] * ray)
    if start is not None:
        R, centre = np.concatenate([start.R[:, 0], R]), np.concatenate([start.centre[:, 0], centre])
        log_scale = np.concatenate([np.log(start.scale), log_scale])
    return Fixed(R, centre, log_scale, len(clip), clip.scale == "free")


@dataclass(frozen=True)
class SupportTerm:
    """``weight * h^2 / (1 + h^2 / far^2)`` in each frame, h the height of the lowest vertex over the support plane.

    Beyond ``far`` more height costs little more: the object may lie on another object on the plane.
    """

    vertices: Float[ndarray, "V 3"]
    """Vertices of the object's convex hull about its centre, unscaled [m]."""
    normal: Float[ndarray, "N 3"]
    """The plane's normal, upwards, in the camera frame."""
    height: Float[ndarray, "N"]
    """Height of the plane over the camera, along the normal [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    far: float = 0.02
    """Height at half of the maximum energy [m]."""
    name: str = "support"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        scale = poses.scale[:, None, None]
        up = np.broadcast_to(self.normal, poses.centre.shape)
        along = scale * (np.swapaxes(poses.R, -1, -2) @ up[..., None])[..., 0] @ self.vertices.T
        lowest = np.argmin(along, axis=-1)
        arm = scale * (poses.R @ self.vertices[lowest][..., None])[..., 0]
        h = np.sum((poses.centre + arm) * up, axis=-1) - self.height
        shape = 1.0 / (1.0 + (h / self.far) ** 2)
        J = np.concatenate([up, np.cross(arm, up), np.sum(arm * up, axis=-1, keepdims=True)], axis=-1)
        slope = 2.0 * self.weight * shape**2 * h
        H = 2.0 * self.weight * (shape**2)[..., None, None] * (J[..., :, None] * J[..., None, :])
        return Quadratic(self.weight * shape * h**2, slope[..., None] * J, H)


def hull_vertices(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "n 3"]:
    """Return the vertices of the convex hull, one of which is the lowest in any pose."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:  # a flat mesh
        return vertices


def plane_in_camera(
    T_world_cam: Float[ndarray, "N 4 4"], up: Float[ndarray, "3"], support: float
) -> tuple[Float[ndarray, "N 3"], Float[ndarray, "N"]]:
    """Return the support plane in each camera frame: its normal, and its height over the camera [m]."""
    normal = (se3.inverse(T_world_cam)[:, :3, :3] @ up[:, None])[..., 0]
    return normal, support - T_world_cam[:, :3, 3] @ up
