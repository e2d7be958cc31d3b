"""HOMan (Hasson et al., "Towards Unconstrained Joint Hand-Object Reconstruction From RGB Videos", 3DV 2021).

The stages: the object alone, from its masks, in the first frame from many rotations, in each later frame from the
previous frame's pose; the best tracks; then objects and hands together, with smoothness, interaction and contact.
docs/method-details.md lists the departures from the published code.

In the joint stage object and hand of every frame are rigid bodies in the camera frame that move together. Three rigid
relations carry all terms: the object in the camera (mask, smoothness), the hand in the camera (smoothness,
reprojection), and the object in the hand (push, pull, interaction). Each term has derivatives by its body's local
7-vector, as for any other method, which are transformed to the 12 numbers of a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.errors import GetagripError
from getagrip.fitting.energy import Energy, PosesInCamera, Term, no_bound
from getagrip.fitting.energy.contact import farthest_point_sampling
from getagrip.fitting.energy.homan_terms import InteractionTerm, ReprojectionTerm, SmoothnessTerm, vertex_moments
from getagrip.fitting.methods import OnStage
from getagrip.fitting.motion import Fixed, Free, PosesInHand
from getagrip.fitting.objective import contact_energy, mask_energy
from getagrip.fitting.problem import EnergyOf, MethodResult, Problem
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.fitting.solver.search import suppress_duplicates
from getagrip.fitting.solver.solve import (
    CURVATURE_FLOOR,
    METRES_PER_RADIAN,
    STATUS_OF_ENDING,
    Adam,
    Solution,
    minimise,
)
from getagrip.geometry import camera, se3
from getagrip.least_squares import BlockArrow
from getagrip.result import Status

HOMAN_LEVEL_PX = 64
"""Resolution of the object's fit alone [px]."""
FIRST_FRAME_ITERATIONS, LATER_FRAME_ITERATIONS = 24, 12
"""Iterations of the object's fit alone: in the first frame, in each later one."""
N_REFINED_TRACKS = 4
"""Number of tracks that are refined; the published code refines the best one."""
N_BOX_POINTS = 64
"""Number of vertices by which the object is placed in a box."""
HOMAN_REFINE_STAGES = ((128, 15), (256, 15))
"""Resolution [px] and iterations of each step of the joint stage."""
SMOOTHNESS_WEIGHT = 3e5
"""Weight of the smoothness of either body [px^2 / m^2]."""
REPROJECTION_WEIGHT = 50.0
"""Weight of the hand's squared reprojection error."""
INTERACTION_WEIGHT = 1e3
"""Weight of the squared distance between the centres [px^2 / m^2]."""
N_REPROJECTED_VERTICES = 30
"""Number of the hand's vertices that are reprojected."""


@dataclass(frozen=True)
class RigidBodies:
    """Object and hand in the camera frame, each rotated about its own centre."""

    R: Float[ndarray, "N 3 3"]
    centre: Float[ndarray, "N 3"]
    log_scale: float
    hand_R: Float[ndarray, "N 3 3"]
    hand_centre: Float[ndarray, "N 3"]
    grip: Float[ndarray, "N 3"]
    """The hand's centre in its own frame."""

    @property
    def scale(self) -> float:
        return float(np.exp(self.log_scale))

    @property
    def T_cam_hand(self) -> Float[ndarray, "N 4 4"]:
        """Poses of the refined hand."""
        return se3.rigid(self.hand_R, self.hand_centre - (self.hand_R @ self.grip[..., None])[..., 0])

    def in_camera(self) -> PosesInCamera:
        """Return the object as the terms read it."""
        return PosesInCamera(self.R[None], self.centre[None], np.array([self.scale]))

    def in_hand(self) -> PosesInHand:
        """Return the object in the refined hand."""
        T_hand_obj = se3.inverse(self.T_cam_hand) @ se3.rigid(self.R, self.centre)
        return PosesInHand(T_hand_obj[None, :, :3, :3], T_hand_obj[None, :, :3, 3], np.array([self.scale]))

    def retract(self, step: Float[ndarray, "N 12"], stretch: float) -> RigidBodies:
        """Apply local steps of object and hand, and of the log scale."""
        return replace(
            self,
            R=se3.exp_so3(step[:, 3:6]) @ self.R,
            centre=self.centre + step[:, :3],
            log_scale=self.log_scale + stretch,
            hand_R=se3.exp_so3(step[:, 9:]) @ self.hand_R,
            hand_centre=self.hand_centre + step[:, 6:9],
        )


@dataclass(frozen=True)
class RefinedTrack:
    """A track of object and hand after the joint stage, with its energy [px^2] in all and per term."""

    bodies: RigidBodies
    energy: float
    terms: dict[str, float]
    status: Status


@dataclass(frozen=True)
class NormalEquations:
    """The normal equations of all frames, by 13 numbers each: object's step, hand's step, the shared log scale."""

    g: Float[ndarray, "N 13"]
    H: Float[ndarray, "N 13 13"]
    cross: Float[ndarray, "N N 13 13"]
    """Between frames."""

    def step(self, damping: Float[ndarray, "1"], free_scale: bool) -> tuple[Float[ndarray, "N 12"], float]:
        """Solve for the damped step of all frames, and of the log scale where it is free."""
        S = int(free_scale)
        J = np.broadcast_to(np.eye(13)[:, [*[12] * S, *range(12)]], (1, len(self.g), 13, S + 12))
        arrow = BlockArrow.by(J, S, self.H[None], self.g[None], np.swapaxes(self.cross, 1, 2)[None])
        shared, local = arrow.step(damping, CURVATURE_FLOOR)
        return local[0], float(shared.sum())


@dataclass(frozen=True)
class JointEnergy:
    """The terms on each of the three rigid relations."""

    object_in_camera: list[Term]
    hand_in_camera: list[Term]
    object_in_hand: list[Term]
    T_cam_hand: Float[ndarray, "N 4 4"]
    """Poses of the input hand, which the terms of ``object_in_hand`` are made for."""

    def __call__(self, bodies: RigidBodies) -> tuple[dict[str, float], NormalEquations]:
        """Compute the energy per term, and its derivatives by the 13 numbers of each frame."""
        N = len(bodies.R)
        eye, scale = np.eye(6), np.array([bodies.scale])
        back = self.T_cam_hand @ se3.inverse(bodies.T_cam_hand)
        turn = back[:, :3, :3]
        J_object, J_hand, J_relative = np.zeros((3, N, 7, 13))
        J_object[:, :6, :6] = J_hand[:, :6, 6:12] = eye
        J_object[:, 6, 12] = J_relative[:, 6, 12] = 1.0
        J_relative[:, :3, :3] = J_relative[:, 3:6, 3:6] = turn
        # Moving the hand moves the object in the hand the other way.
        J_relative[:, :3, 6:9] = J_relative[:, 3:6, 9:12] = -turn
        J_relative[:, :3, 9:12] = turn @ se3.hat(bodies.centre - bodies.hand_centre)
        relative = PosesInCamera(
            np.ascontiguousarray(turn @ bodies.R)[None], se3.transform(back, bodies.centre[:, None])[None, :, 0], scale
        )
        relations = (
            (self.object_in_camera, bodies.in_camera(), J_object),
            (self.hand_in_camera, PosesInCamera(bodies.hand_R[None], bodies.hand_centre[None], np.ones(1)), J_hand),
            (self.object_in_hand, relative, J_relative),
        )
        values: dict[str, float] = {}
        g, H, cross = np.zeros((N, 13)), np.zeros((N, 13, 13)), np.zeros((N, N, 13, 13))
        for terms, poses, J in relations:
            Jt = np.swapaxes(J, -1, -2)
            for term in terms:
                local = term(poses, no_bound(poses))
                values[term.name] = values.get(term.name, 0.0) + float(local.value.sum())
                g += (Jt @ local.g[0, ..., None])[..., 0]
                H += Jt @ local.H[0] @ J
                if local.cross is not None:
                    cross += Jt[:, None] @ np.swapaxes(local.cross[0], 1, 2) @ J[None]
        return values, NormalEquations(g, H, cross)


def refine_track(problem: Problem, track: Free, contact: EnergyOf) -> RefinedTrack:
    """Refine object and hand, from one track of the object and the input hand, by Levenberg-Marquardt."""
    bodies = make_rigid_bodies(problem, track)
    for level, iterations in HOMAN_REFINE_STAGES:
        energy = joint_energy(problem, level, bodies, contact)
        refined = refine_by_levenberg_marquardt(energy, bodies, iterations, track.free_scale)
        bodies = refined.bodies
    return refined


def make_rigid_bodies(problem: Problem, track: Free) -> RigidBodies:
    """Make object and hand from a track of the object and the input hand."""
    T_cam_hand, grip = problem.clip.hand.T_cam_hand, problem.clip.hand.vertices.mean(axis=1)
    hand_centre = se3.transform(T_cam_hand, grip[:, None])[:, 0]
    return RigidBodies(track.R[0], track.centre[0], float(track.log_scale[0]), T_cam_hand[:, :3, :3], hand_centre, grip)


def joint_energy(problem: Problem, level: int, bodies: RigidBodies, contact: EnergyOf) -> JointEnergy:
    """Build the terms at one resolution."""
    clip, K = problem.clip, problem.observation.K
    everywhere = np.arange(len(clip))
    about_grip = clip.hand.vertices - bodies.grip[:, None]
    points = about_grip[:, farthest_point_sampling(about_grip[0], N_REPROJECTED_VERTICES)]
    tracked = clip.hand.T_cam_hand
    grip = se3.transform(tracked, bodies.grip[:, None])
    crop = np.zeros((len(K), 3, 3))
    crop[:, [0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] = np.concatenate([K, np.ones((len(K), 1))], axis=1)
    target = camera.project(crop, points @ np.swapaxes(tracked[:, :3, :3], 1, 2) + grip)
    smooth = SmoothnessTerm(vertex_moments(clip.mesh.vertices - clip.mesh.centre), SMOOTHNESS_WEIGHT)
    hand_smooth = SmoothnessTerm(vertex_moments(about_grip.mean(axis=0)), SMOOTHNESS_WEIGHT, name="hand_smoothness")
    return JointEnergy(
        object_in_camera=[*mask_energy(problem)(level, everywhere), smooth],
        hand_in_camera=[hand_smooth, ReprojectionTerm(points, K, target, REPROJECTION_WEIGHT)],
        object_in_hand=[*contact(problem)(level, everywhere), InteractionTerm(grip[:, 0], INTERACTION_WEIGHT)],
        T_cam_hand=tracked,
    )


@dataclass(frozen=True)
class _TrackState:
    """A track at its current poses (``least_squares.State``)."""

    energy: JointEnergy
    bodies: RigidBodies
    free_scale: bool
    values: dict[str, float]
    equations: NormalEquations

    @staticmethod
    def of(energy: JointEnergy, bodies: RigidBodies, free_scale: bool) -> _TrackState:
        return _TrackState(energy, bodies, free_scale, *energy(bodies))

    @property
    def cost(self) -> Float[ndarray, "1"]:
        return np.array([sum(self.values.values())])

    def trial(self, active: Int[ndarray, "1"], damping: Float[ndarray, "1"]) -> _TrackState:
        bodies = self.bodies.retract(*self.equations.step(damping, self.free_scale))
        return _TrackState.of(self.energy, bodies, self.free_scale)

    def accept(self, trial: _TrackState, active: Int[ndarray, "1"], better: Bool[ndarray, "1"]) -> _TrackState:
        return trial if better[0] else self


def refine_by_levenberg_marquardt(
    energy: JointEnergy, bodies: RigidBodies, iterations: int, free_scale: bool
) -> RefinedTrack:
    """Refine all numbers of a track at once by Levenberg-Marquardt, with the rules of ``solve.minimise``."""
    found = least_squares.minimise(_TrackState.of(energy, bodies, free_scale), iterations)
    values = found.state.values
    return RefinedTrack(found.state.bodies, sum(values.values()), values, STATUS_OF_ENDING[found.endings[0]])


def refine_by_adam(
    energy: JointEnergy, bodies: RigidBodies, iterations: int, rate: float, free_scale: bool
) -> RefinedTrack:
    """Refine all numbers of a track at once by Adam; the best iterate counts."""
    N = len(bodies.R)
    lengths = np.tile(np.arange(12) % 6 < 3, N)
    steps = Adam(np.append(np.where(lengths, METRES_PER_RADIAN, 1.0), 1.0), iterations, rate)
    best = RefinedTrack(bodies, np.inf, {}, Status.INVISIBLE)
    for _ in range(iterations + 1):
        values, equations = energy(bodies)
        if (cost := sum(values.values())) < best.energy:
            best = RefinedTrack(bodies, cost, values, Status.FINISHED)
        step = steps.step(np.append(equations.g[:, :12], equations.g[:, 12].sum()))
        bodies = bodies.retract(step[:-1].reshape(N, 12), float(step[-1]) if free_scale else 0.0)
    return best


@dataclass(frozen=True)
class HomanSolver:
    """The energy and the optimiser of the stages."""

    contact: EnergyOf
    """Returns push and pull."""
    alone: Callable[[Problem, Fixed, int], Solution[Fixed]]
    """Fits the object to its mask in one frame, in the camera frame."""
    together: Callable[[Problem, Free, EnergyOf], RefinedTrack]
    """Refines a track of the object together with the hand."""
    badness: Callable[[Problem, Sequence[RefinedTrack]], Float[ndarray, "k"]]
    """Ranks refined tracks, the best lowest."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit by our energy and optimiser. Raises ``GetagripError`` when no pose can be rendered."""
    return fit_by_solver(OUR_HOMAN_SOLVER, problem, on_stage)


def fit_by_solver(way: HomanSolver, problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit the object alone, and refine the best tracks together with the hand.

    Raises ``GetagripError`` when no pose can be rendered.
    """
    tracks, loss = object_tracks(problem, way)
    chosen = suppress_duplicates(tracks.poses(), loss, problem.surface, N_REFINED_TRACKS)
    if not len(chosen):
        raise GetagripError(Status.INVISIBLE.sentence)
    on_stage("coarse")
    refined = [way.together(problem, tracks.take(chosen[k : k + 1]), way.contact) for k in range(len(chosen))]
    energy = np.array([r.energy for r in refined])
    poses = reduce(PosesInHand.concatenate, [r.bodies.in_hand() for r in refined])
    score = np.where(np.isfinite(energy), way.badness(problem, refined), np.inf)
    best = suppress_duplicates(poses, score, problem.surface, N_REFINED_TRACKS)
    if not len(best):
        raise GetagripError(Status.INVISIBLE.sentence)
    on_stage("finest")
    first = refined[best[0]]
    return MethodResult(poses.take(best), energy[best], first.terms, first.status)


def _fit_object_in_frame(problem: Problem, start: Fixed, n: int) -> Solution[Fixed]:
    terms = mask_energy(problem)(HOMAN_LEVEL_PX, np.array([n]))
    return minimise(start, terms, np.eye(4)[None], LATER_FRAME_ITERATIONS if n else FIRST_FRAME_ITERATIONS)


def _contact_energy(problem: Problem) -> Energy:
    return contact_energy(problem, problem.options.push, problem.options.pull)


OUR_HOMAN_SOLVER = HomanSolver(
    contact=_contact_energy,
    alone=_fit_object_in_frame,
    together=refine_track,
    badness=lambda _, refined: np.array([r.energy for r in refined]),
)


def object_tracks(problem: Problem, way: HomanSolver = OUR_HOMAN_SOLVER) -> tuple[Free, Float[ndarray, "B"]]:
    """Track the object in the camera frame from each initial rotation, by E_mask alone; also return E_mask / area."""
    clip, area = problem.clip, problem.observation.area
    initial = initial_poses(clip, problem.masks, problem.inits, problem.options.seed, problem.prior_poses)
    vertices = clip.mesh.vertices - clip.mesh.centre
    points = np.exp(initial.log_scale[0]) * vertices[farthest_point_sampling(vertices, N_BOX_POINTS)]
    boxes = camera.bounding_boxes(problem.masks.object).astype(float)
    R = clip.hand.T_cam_hand[0, :3, :3] @ initial.R
    rotations, centres, loss = [], [], np.zeros(len(R))
    for n, K in enumerate(clip.K):
        start = Fixed(R, place_in_box(R, points, K, boxes[n]), initial.log_scale, frames=1)
        found = way.alone(problem, start, n)
        R = found.motion.R
        rotations.append(R)
        centres.append(found.motion.centre)
        loss += found.energy / (area[n] * len(clip))
    free = clip.scale == "free"
    return Free(np.stack(rotations, axis=1), np.stack(centres, axis=1), initial.log_scale, free), loss


def place_in_box(
    R: Float[ndarray, "B 3 3"],
    points: Float[ndarray, "P 3"],
    K: Float[ndarray, "3 3"],
    box: Float[ndarray, "4"],
    steps: int = 10,
) -> Float[ndarray, "B 3"]:
    """Place rotated points [m] so that the box around them has the centre and diagonal of another box.

    By fixed point, as in the published code: depth times the ratio of diagonals, then the remaining shift along the ray
    through the box's centre.
    """
    placed = points @ np.swapaxes(R, -1, -2)
    middle, diagonal = (box[:2] + box[2:]) / 2.0, np.linalg.norm(box[2:] - box[:2])
    ray = camera.backproject(K, middle[None])[0]
    centre = np.tile(ray, (len(R), 1))
    for _ in range(steps):
        uv = camera.project(K, placed + centre[:, None])
        low, high = uv.min(axis=1), uv.max(axis=1)
        depth = centre[:, 2] * np.linalg.norm(high - low, axis=1) / diagonal
        off = middle - (low + high) / 2.0
        shift = off * centre[:, 2:] / K[[0, 1], [0, 1]]
        centre[:, :2] = (centre[:, :2] + shift) * (depth / centre[:, 2])[:, None]
        centre[:, 2] = np.maximum(depth, 2.0 * np.abs(placed[..., 2]).max(axis=1))
    return centre
