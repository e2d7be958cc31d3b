"""The joint stage of HOMan: object and hand of every frame, each a rigid body in the camera frame, moved together.

Three rigid relations carry all terms: the object as the camera sees it (mask, smoothness), the hand as the camera sees
it (smoothness, reprojection), and the object as the hand sees it (push, pull, interaction). Each term answers with
derivatives by its body's local 7-vector, as for any other method; here they are taken to the 12 numbers of a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.fitting.adam import METRES_PER_RADIAN, Adam
from getagrip.fitting.contact import farthest_point_sampling
from getagrip.fitting.energy import PosesInCamera, Term, no_bound
from getagrip.fitting.energy.interaction import InteractionTerm
from getagrip.fitting.energy.reprojection import ReprojectionTerm
from getagrip.fitting.energy.smoothness import SmoothnessTerm, vertex_moments
from getagrip.fitting.motion import Free, PosesInHand
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.problem import EnergyOf, Problem
from getagrip.fitting.solve import CURVATURE_FLOOR, STATUS_OF_ENDING
from getagrip.geometry import camera, se3
from getagrip.least_squares import BlockArrow
from getagrip.result import Status

HOMAN_REFINE_STAGES = ((128, 15), (256, 15))
"""Resolution [px] and iterations of each stage."""
SMOOTHNESS_WEIGHT = 3e5
"""Weight of the smoothness of either body [px^2 / m^2]."""
REPROJECTION_WEIGHT = 50.0
"""Weight of the hand's squared reprojection error."""
INTERACTION_WEIGHT = 1e3
"""Weight of the squared distance between the centres [px^2 / m^2]."""
N_REPROJECTED_VERTICES = 30
"""Vertices of the hand that are reprojected."""


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
        """The hand, refined."""
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
    """A refined track."""

    bodies: RigidBodies
    energy: float
    terms: dict[str, float]
    status: Status


@dataclass(frozen=True)
class NormalEquations:
    """The normal equations of all frames.

    Each frame has 13 numbers: object's step, hand's step, log scale (which all frames share).
    """

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
    """The terms on each of the three relations."""

    object_in_camera: list[Term]
    hand_in_camera: list[Term]
    object_in_hand: list[Term]
    T_cam_hand: Float[ndarray, "N 4 4"]
    """The hand as given; the terms of ``object_in_hand`` were made for it."""

    def __call__(self, bodies: RigidBodies) -> tuple[dict[str, float], NormalEquations]:
        """Energy per term, and its derivatives by the 13 numbers of each frame."""
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
        refined = refine_by_levenberg_marquardt(
            joint_energy(problem, level, bodies, contact), bodies, iterations, track.free_scale
        )
        bodies = refined.bodies
    return refined


def make_rigid_bodies(problem: Problem, track: Free) -> RigidBodies:
    """Return object and hand as a track of the object and the input hand place them."""
    tracked = problem.clip.hand
    grip = tracked.vertices.mean(axis=1)
    return RigidBodies(
        R=track.R[0],
        centre=track.centre[0],
        log_scale=float(track.log_scale[0]),
        hand_R=tracked.T_cam_hand[:, :3, :3],
        hand_centre=se3.transform(tracked.T_cam_hand, grip[:, None])[:, 0],
        grip=grip,
    )


def joint_energy(problem: Problem, level: int, bodies: RigidBodies, contact: EnergyOf) -> JointEnergy:
    """Build the terms at one resolution."""
    clip, K = problem.clip, problem.observation.K
    everywhere = np.arange(len(clip))
    mask = mask_energy(problem)(level, everywhere)
    about_grip = clip.hand.vertices - bodies.grip[:, None]
    points = about_grip[:, farthest_point_sampling(about_grip[0], N_REPROJECTED_VERTICES)]
    tracked = clip.hand.T_cam_hand
    grip = se3.transform(tracked, bodies.grip[:, None])
    crop = np.zeros((len(K), 3, 3))
    crop[:, [0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] = np.concatenate([K, np.ones((len(K), 1))], axis=1)
    target = camera.project(crop, points @ np.swapaxes(tracked[:, :3, :3], 1, 2) + grip)
    return JointEnergy(
        object_in_camera=[
            *mask,
            SmoothnessTerm(vertex_moments(clip.mesh.vertices - clip.mesh.centre), SMOOTHNESS_WEIGHT),
        ],
        hand_in_camera=[
            SmoothnessTerm(vertex_moments(about_grip.mean(axis=0)), SMOOTHNESS_WEIGHT, name="hand_smoothness"),
            ReprojectionTerm(points, K, target, REPROJECTION_WEIGHT),
        ],
        object_in_hand=[
            *contact(problem)(level, everywhere),
            InteractionTerm(grip[:, 0], INTERACTION_WEIGHT),
        ],
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
        return _TrackState.of(
            self.energy, self.bodies.retract(*self.equations.step(damping, self.free_scale)), self.free_scale
        )

    def accept(self, trial: _TrackState, active: Int[ndarray, "1"], better: Bool[ndarray, "1"]) -> _TrackState:
        return trial if better[0] else self


def refine_by_levenberg_marquardt(
    energy: JointEnergy, bodies: RigidBodies, iterations: int, free_scale: bool
) -> RefinedTrack:
    """Run Levenberg-Marquardt on all numbers of a track at once, by the rules of ``solve.minimise``."""
    found = least_squares.minimise(_TrackState.of(energy, bodies, free_scale), iterations)
    values = found.state.values
    return RefinedTrack(found.state.bodies, sum(values.values()), values, STATUS_OF_ENDING[found.endings[0]])


def refine_by_adam(
    energy: JointEnergy, bodies: RigidBodies, iterations: int, rate: float, free_scale: bool
) -> RefinedTrack:
    """Run Adam on all numbers of a track at once; the best iterate counts."""
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
