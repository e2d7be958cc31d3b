"""The joint stage of HOMan: object and hand of every frame, each a rigid body in the camera frame, moved together.

Three rigid relations carry all terms: the object as the camera sees it (mask, smoothness), the hand as the camera sees
it (smoothness, reprojection), and the object as the hand sees it (push, pull, interaction). Each term answers with
derivatives by its body's local 7-vector, as for any other method; here they are taken to the 12 numbers of a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.contact import spread_points
from getagrip.fitting.energy import Local, Poses, Term, no_bound
from getagrip.fitting.energy.interaction import InteractionTerm
from getagrip.fitting.energy.reprojection import ReprojectionTerm
from getagrip.fitting.energy.smoothness import SmoothnessTerm, moments
from getagrip.fitting.motion import Free
from getagrip.fitting.objective import energy_of
from getagrip.fitting.problem import Problem
from getagrip.fitting.search import Stage
from getagrip.fitting.solve import Status
from getagrip.geometry import camera, se3

STAGES = (
    Stage("fine", level=128, frames=0, iterations=15, keep=0),
    Stage("finest", level=256, frames=0, iterations=15, keep=0),
)
SMOOTH = 3e5
"""Weight of the smoothness of either body [px^2 / m^2]."""
REPROJECT = 50.0
"""Weight of the hand's squared reprojection error."""
INTERACT = 1e3
"""Weight of the squared distance between the centres [px^2 / m^2]."""
SEEN_POINTS = 30
"""Vertices of the hand that are reprojected."""
_FLOOR = 1e2
"""As in ``solve``."""


@dataclass(frozen=True)
class Bodies:
    """Object and hand in the camera frame, each turned about its own centre."""

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

    def T_hand_obj(self, centre: Float[ndarray, "3"]) -> Float[ndarray, "N 4 4"]:
        """The object in the refined hand, for the mesh's centre in its own frame."""
        return se3.inverse(self.T_cam_hand) @ se3.rigid(self.R, self.centre - self.scale * (self.R @ centre))

    def moved(self, step: Float[ndarray, "N 12"], stretch: float) -> Bodies:
        """After local steps of object and hand, and of the log scale."""
        return replace(
            self,
            R=se3.exp_so3(step[:, 3:6]) @ self.R,
            centre=self.centre + step[:, :3],
            log_scale=self.log_scale + stretch,
            hand_R=se3.exp_so3(step[:, 9:]) @ self.hand_R,
            hand_centre=self.hand_centre + step[:, 6:9],
        )


@dataclass(frozen=True)
class Refined:
    """A refined track."""

    bodies: Bodies
    energy: float
    terms: dict[str, float]
    status: Status


@dataclass(frozen=True)
class JointEnergy:
    """The terms on each of the three relations."""

    seen_object: list[Term]
    seen_hand: list[Term]
    held: list[Term]
    T_cam_hand: Float[ndarray, "N 4 4"]
    """The hand as given; the terms of ``held`` have it where they have the hand."""

    def __call__(self, bodies: Bodies) -> tuple[dict[str, float], Float[ndarray, "N 13"], Float[ndarray, "N N 13 13"]]:
        """Energy per term, gradient and Hessian by (object's step, hand's step, log scale) of each frame."""
        N = len(bodies.R)
        eye, scale = np.eye(6), np.array([bodies.scale])
        back = self.T_cam_hand @ se3.inverse(bodies.T_cam_hand)
        turn = back[:, :3, :3]
        J_object, J_hand, J_held = np.zeros((3, N, 7, 13))
        J_object[:, :6, :6] = J_hand[:, :6, 6:12] = eye
        J_object[:, 6, 12] = J_held[:, 6, 12] = 1.0
        J_held[:, :3, :3] = J_held[:, 3:6, 3:6] = turn
        # Moving the hand moves the object in the hand the other way.
        J_held[:, :3, 6:9] = J_held[:, 3:6, 9:12] = -turn
        J_held[:, :3, 9:12] = turn @ se3.hat(bodies.centre - bodies.hand_centre)
        held = Poses(
            np.ascontiguousarray(turn @ bodies.R)[None], se3.transform(back, bodies.centre[:, None])[None, :, 0], scale
        )
        relations = (
            (self.seen_object, Poses(bodies.R[None], bodies.centre[None], scale), J_object),
            (self.seen_hand, Poses(bodies.hand_R[None], bodies.hand_centre[None], np.ones(1)), J_hand),
            (self.held, held, J_held),
        )
        values: dict[str, float] = {}
        g, H = np.zeros((N, 13)), np.zeros((N, N, 13, 13))
        n = np.arange(N)
        for terms, poses, J in relations:
            Jt = np.swapaxes(J, -1, -2)
            for term in terms:
                local: Local = term(poses, no_bound(poses))
                values[term.name] = values.get(term.name, 0.0) + float(local.value.sum())
                g += (Jt @ local.g[0, ..., None])[..., 0]
                H[n, n] += Jt @ local.H[0] @ J
                if local.across is not None:
                    H += Jt[:, None] @ np.swapaxes(local.across[0], 1, 2) @ J[None]
        return values, g, H


def refine(problem: Problem, track: Free) -> Refined:
    """Object and hand from one track of the object and the given hand."""
    given = problem.clip.hand
    grip = given.vertices.mean(axis=1)
    bodies = Bodies(
        R=track.R[0],
        centre=track.centre[0],
        log_scale=float(track.log_scale[0]),
        hand_R=given.T_cam_hand[:, :3, :3],
        hand_centre=se3.transform(given.T_cam_hand, grip[:, None])[:, 0],
        grip=grip,
    )
    for stage in STAGES:
        refined = descend(joint_energy(problem, stage, bodies), bodies, stage.iterations, track.free_scale)
        bodies = refined.bodies
    return refined


def joint_energy(problem: Problem, stage: Stage, bodies: Bodies) -> JointEnergy:
    """The terms at one resolution."""
    clip, options, K = problem.clip, problem.options, problem.observation.K
    mask, *contact = energy_of(problem, options.push, options.pull)(stage, np.arange(len(clip)))
    about_grip = clip.hand.vertices - bodies.grip[:, None]
    points = about_grip[:, spread_points(about_grip[0], SEEN_POINTS)]
    given = clip.hand.T_cam_hand
    grip = se3.transform(given, bodies.grip[:, None])
    crop = np.zeros((len(K), 3, 3))
    crop[:, [0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] = np.concatenate([K, np.ones((len(K), 1))], axis=1)
    target = camera.project(crop, points @ np.swapaxes(given[:, :3, :3], 1, 2) + grip)
    return JointEnergy(
        seen_object=[mask, SmoothnessTerm(moments(clip.mesh.vertices - clip.mesh.centre), SMOOTH)],
        seen_hand=[
            SmoothnessTerm(moments(about_grip.mean(axis=0)), SMOOTH, name="hand_smoothness"),
            ReprojectionTerm(points, K, target, REPROJECT),
        ],
        held=[*contact, InteractionTerm(grip[:, 0], INTERACT)],
        T_cam_hand=given,
    )


def descend(energy: JointEnergy, bodies: Bodies, iterations: int, free_scale: bool) -> Refined:
    """Levenberg-Marquardt with the rules of ``solve.minimise``, on all numbers of a track at once."""
    N = len(bodies.R)
    values, g, H = energy(bodies)
    lam, rejects, small = 1e-2, 0, 0
    for _ in range(iterations):
        if rejects == 4 or small == 2:
            break
        A = np.empty((12 * N + 1, 12 * N + 1))
        A[:-1, :-1] = np.swapaxes(H[..., :12, :12], 1, 2).reshape(12 * N, 12 * N)
        A[-1, :-1] = A[:-1, -1] = H[..., :12, 12].sum(axis=1).ravel()
        A[-1, -1] = H[..., 12, 12].sum()
        b = np.append(g[:, :12].ravel(), g[:, 12].sum())
        A[np.diag_indices_from(A)] += lam * (np.diag(A) + _FLOOR)
        unknown = slice(None) if free_scale else slice(-1)
        step = np.zeros(12 * N + 1)
        step[unknown] = -np.linalg.solve(A[unknown, unknown], b[unknown])
        trial = bodies.moved(step[:-1].reshape(N, 12), float(step[-1]))
        new = energy(trial)
        total, now = sum(new[0].values()), sum(values.values())
        if total < now:
            bodies, (values, g, H) = trial, new
            lam, rejects = max(0.3 * lam, 1e-7), 0
            small = small + 1 if now - total < 1e-3 * now else 0
        else:
            lam, rejects = min(6.0 * lam, 1e7), rejects + 1
    status = Status.CONVERGED if small == 2 else Status.STUCK if rejects == 4 else Status.LIMIT
    return Refined(bodies, sum(values.values()), values, status)
