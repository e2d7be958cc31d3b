"""Fit a hand model to 21 joints per frame: one shape for all frames, a pose and ``T_cam_hand`` for each.

The fit minimises, over the shape b, the poses q_n and the rigid motions T_n,

    sum_n sum_i |T_n X_i(b, q_n) - Y_n,i|^2 / JOINT_SIGMA_M_i^2 + sum_n |prior(q_n)|^2 + |b / spread|^2

by Levenberg-Marquardt (``least_squares``) with analytic Jacobians. Only b couples the frames: the normal equations are
block-arrow, and eliminating the 51 numbers of each frame leaves a small system in b (Schur complement).

``prior`` is ``PosePrior``: fingers bend about one axis and hardly twist or spread. Each joint's rotation vector, in the
joint's own axes (twist along the bone, bend about the hinge, spread across both), is Gaussian. Bends also have limits,
slightly beyond the normal ranges of motion (American Academy of Orthopaedic Surgeons: 0-90, 0-100 and 0-90 degrees from
knuckle to fingertip; thumb 0-50 and 0-80).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS, HandTrack
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.hands.generic import THUMB_PAD_DIRECTION
from getagrip.hands.model import KNUCKLES, HandModel, hand_track, mirrored
from getagrip.least_squares import BlockArrow, DampingRules, Ending, minimise

JointOrder = Literal["openpose", "ho3d"]
"""``openpose``, this package's own: wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip.
``ho3d``, also DexYCB's MANO joints: wrist, then index, middle, pinky, ring, thumb, three joints each, then the tips of
thumb, index, middle, ring, pinky."""
JOINT_ORDERS: dict[JointOrder, list[int]] = {
    "openpose": list(range(21)),
    "ho3d": [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20],
}
"""Index of each of this package's 21 joints in another order."""
JOINT_SIGMA_M = np.array([0.003, 0.010, *[0.003] * 19])
"""Standard deviation of each joint's position [m]. Models disagree by a centimetre on the thumb's saddle joint."""
MAX_JOINT_STEPS = 40
MAX_JOINT_COORDINATE_M = 1e5
"""Maximum coordinate of a joint [m]: also 100 m in millimetres."""
FINGER_BENDS_RAD, THUMB_BENDS_RAD = (0.43, 0.64, 0.10), (0.37, 0.0, 0.28)
"""Mean bend of each joint, from knuckle to fingertip, in real grasps: two moments of each of 41 in DexYCB [rad]. Were
they straighter, hands lifted from 2D landmarks would be larger than they are seen, and so put too far away."""
FINGER_SIGMA_RAD = np.array([[0.10, 0.8, 0.25], [0.05, 0.8, 0.05], [0.05, 0.6, 0.05]])
"""Standard deviations of twist, bend and spread, from knuckle to fingertip [rad]."""
THUMB_SIGMA_RAD = np.array([[0.30, 0.5, 0.50], [0.15, 0.6, 0.20], [0.05, 0.6, 0.05]])
FINGER_LIMITS = np.radians([[-30.0, 100.0], [-10.0, 115.0], [-15.0, 90.0]])
"""Minimum and maximum bend [rad]."""
THUMB_LIMITS = np.radians([[-40.0, 60.0], [-30.0, 70.0], [-25.0, 95.0]])
LIMIT_SIGMA_RAD = 0.05
"""Bend beyond a limit that costs one unit [rad]."""
N_FRAME_PARAMETERS = 51
"""Parameters of each frame: the step of T_cam_hand and the pose. Parameters shared by all frames follow them."""
DESCENT_RULES = DampingRules(
    damping=1e-3, success=0.1, failure=10.0, least=1e-9, most=1e8, rejections=np.inf, tolerance=1e-5, small_steps=1
)
Equations = tuple[float, Float[ndarray, "T D D"], Float[ndarray, "T D"]]
"""The cost, and per frame J^T J and J^T r of its own parameters and the shared ones."""


@dataclass(frozen=True)
class HandFit:
    """A hand model fitted to joints.

    Attributes:
        hand: the fitted hand.
        shape: (S,) shape parameters, one set for all frames.
        pose: (T, 45) rotation vectors relative to the flat hand [rad].
        residuals: (T, 21) distance of each fitted joint from the observed one [m], in this package's order.
        converged: whether the descent converged before its limit of steps.
    """

    hand: HandTrack
    shape: Float[ndarray, "S"]
    pose: Float[ndarray, "T 45"]
    residuals: Float[ndarray, "T 21"]
    converged: bool


class JointsError(UsageError):
    """Joints that cannot be a hand's."""

    def __init__(self, got: str, expected: str, advice: str = "") -> None:
        self.got, self.expected = got, f"{expected}; {advice}" if advice else expected
        super().__init__(f"joints must be {expected} (got {got}){f'; {advice}' if advice else ''}")


def fit_joints(model: HandModel, joints_cam: Float[ndarray, "..."], order: JointOrder) -> HandFit:
    """Fit a hand to joints (T, 21, 3) in the camera frame [m].

    Raises ``UsageError`` for an unknown order, another shape, non-finite numbers, or a hand of absurd size.
    """
    Y = _check_joint_positions(joints_cam, order)
    chains, prior = Chains.of(model), PosePrior.of(model)
    start = JointFitUnknowns(
        _align_flat_hand(model, Y), np.zeros((len(Y), 5, 3, 3)), np.zeros(len(model.shape_names)), chains.wrist
    )
    start.q[..., :, :] = prior.mean
    state, _, converged = descend(start, lambda at: _normal_equations(model, chains, prior, at, Y), MAX_JOINT_STEPS)
    pose = model_pose(state.q)
    posed = model.with_shape(state.shape).with_pose(pose)
    residuals = np.linalg.norm(se3.transform(state.T, posed.joints) - Y, axis=-1)
    return HandFit(hand_track(posed, state.T), state.shape, pose, residuals, converged)


def _check_joint_positions(joints_cam: Float[ndarray, "..."], order: JointOrder) -> Float[ndarray, "T 21 3"]:
    if order not in JOINT_ORDERS:
        raise UsageError(f"unknown joint order {order!r}; choose from {', '.join(JOINT_ORDERS)}")
    Y = np.asarray(joints_cam, dtype=float)
    if Y.ndim != 3 or Y.shape[1:] != (21, 3) or len(Y) == 0:
        raise JointsError(f"{Y.shape}", "of shape (T, 21, 3) with T > 0")
    bad = np.flatnonzero(~np.isfinite(Y).all(axis=(1, 2)))
    if bad.size:
        got = f"NaN or infinite numbers in {bad.size} frames, first {bad[0]}"
        raise JointsError(got, "finite", "leave these frames out")
    if np.abs(Y).max() > MAX_JOINT_COORDINATE_M:
        raise JointsError(f"a coordinate of {np.abs(Y).max():.4g} m", f"at most {MAX_JOINT_COORDINATE_M:g} m away")
    Y = Y[:, JOINT_ORDERS[order]]
    palm = np.linalg.norm(Y[:, 9] - Y[:, 0], axis=1)
    if palm.min() < 0.03 or palm.max() > 0.25:
        got = f"{1e3 * palm.min():.3g} to {1e3 * palm.max():.3g} mm"
        asked = "is the unit the metre, is the order right?"
        raise JointsError(got, "30 to 250 mm from wrist to middle knuckle", asked)
    return Y


def _align_flat_hand(model: HandModel, Y: Float[ndarray, "T 21 3"]) -> Float[ndarray, "T 4 4"]:
    """Return the T_cam_hand that aligns the flat mean hand's wrist and knuckles with joints (Kabsch's algorithm)."""
    X = model.joints[[0, *KNUCKLES[1:]]]
    palm = Y[:, [0, 5, 9, 13, 17]]
    R = se3.nearest_rotation(np.swapaxes(palm - palm.mean(axis=1, keepdims=True), 1, 2) @ (X - X.mean(axis=0)))
    return se3.rigid(R, palm.mean(axis=1) - R @ X.mean(axis=0))


def _normal_equations(
    model: HandModel, chains: Chains, prior: PosePrior, state: JointFitUnknowns, Y: Float[ndarray, "T 21 3"]
) -> Equations:
    """Compute the cost, and per frame J^T J and J^T r of (T_cam_hand step, pose, shape)."""
    X, J = joints_and_jacobian(chains, state.q, state.shape)
    R = state.T[:, :3, :3]
    # In the hand's axes, those of the Jacobian; distances are the same.
    r: ndarray = ((X - (Y - state.T[:, None, :3, 3]) @ R) / JOINT_SIGMA_M[:, None]).reshape(len(Y), 63)
    J = (J / JOINT_SIGMA_M[:, None, None]).reshape(len(Y), 63, -1)
    p, P = prior.residuals(state.q)
    b = state.shape / model.shape_spread
    cost = float(np.sum(r * r) + np.sum(p * p) + b @ b)
    H, g = np.swapaxes(J, 1, 2) @ J, (r[:, None] @ J)[:, 0]
    H[:, 6:51, 6:51] += np.swapaxes(P, 1, 2) @ P
    g[:, 6:51] += (p[:, None] @ P)[:, 0]
    S = len(b)  # the shape's prior is divided among the frames, so that their sum has it once
    H[:, 51:, 51:] += np.diag(1.0 / model.shape_spread**2).reshape(S, S) / len(Y)
    g[:, 51:] += b / model.shape_spread / len(Y)
    return cost, H, g


class JointFitUnknowns(NamedTuple):
    """The unknowns of the fit."""

    T: Float[ndarray, "T 4 4"]
    """T_cam_hand."""
    q: Float[ndarray, "T 5 3 3"]
    """Rotation vectors of the three joints of each of the ``FINGERS``."""
    shape: Float[ndarray, "S"]
    wrist: Float[ndarray, "3"]
    """Wrist of the mean hand, the centre of rotations."""

    def retract(self, frames: Float[ndarray, "T 51"], shared: Float[ndarray, "S"]) -> JointFitUnknowns:
        """Apply a step (``apply_hand_step``); pose and shape add up."""
        T = apply_hand_step(self.T, frames[:, :6], self.wrist)
        return self._replace(T=T, q=self.q + frames[:, 6:].reshape(self.q.shape), shape=self.shape + shared)


def model_pose(q: Float[ndarray, "T 5 3 3"]) -> Float[ndarray, "T 45"]:
    """Convert rotation vectors of the ``FINGERS``' joints to a pose of ``ShapedHand``."""
    pose = np.zeros((len(q), 45))
    for n, knuckle in enumerate(KNUCKLES):
        pose[:, 3 * knuckle - 3 : 3 * knuckle + 6] = q[:, n].reshape(len(q), 9)
    return pose


def apply_hand_step(
    T: Float[ndarray, "T 4 4"], step: Float[ndarray, "T 6"], wrist: Float[ndarray, "3"]
) -> Float[ndarray, "T 4 4"]:
    """Shift hands in their own axes and turn them about the wrist."""
    R = se3.exp_so3(step[:, 3:])
    return T @ se3.rigid(R, step[:, :3] + wrist - R @ wrist)


class Chains(NamedTuple):
    """The fingers as chains of points (three joints and the tip), linear in the shape."""

    wrist: Float[ndarray, "3"]
    wrist_directions: Float[ndarray, "3 S"]
    points: Float[ndarray, "5 4 3"]
    directions: Float[ndarray, "5 4 3 S"]

    @staticmethod
    def of(model: HandModel) -> Chains:
        """Build the chains of a model; tips are vertices that move with the last joint."""
        each = np.array(KNUCKLES)[:, None] + np.arange(3)
        return Chains(
            model.joints[0],
            model.joint_directions[0],
            np.concatenate([model.joints[each], model.template[model.tips][:, None]], axis=1),
            np.concatenate([model.joint_directions[each], model.shape_directions[model.tips][:, None]], axis=1),
        )


def joints_and_jacobian(
    chains: Chains, q: Float[ndarray, "T 5 3 3"], shape: Float[ndarray, "S"]
) -> tuple[Float[ndarray, "T 21 3"], Float[ndarray, "T 21 3 D"]]:
    """Compute the 21 joints in the hand frame, and their derivatives by the T_cam_hand step, the pose and the shape.

    A joint's rotation vector q turns the points X beyond it on its finger: dX = (G Jr(q) dq) x (X - X_joint), with G
    the joint's orientation and Jr the right Jacobian of SO(3).
    """
    T, S = len(q), len(shape)
    X = np.empty((T, 21, 3))
    J = np.zeros((T, 21, 3, 51 + S))
    X[:, 0], J[:, 0, :, 51:] = chains.wrist + chains.wrist_directions @ shape, chains.wrist_directions
    rest = chains.points + chains.directions @ shape
    R, Jr = se3.exp_so3(q), se3.right_jacobian(q)
    for n in range(5):
        at = 1 + 4 * n
        X[:, at], J[:, at, :, 51:] = rest[n, 0], chains.directions[n, 0]
        G = np.broadcast_to(np.eye(3), (T, 3, 3))
        axes = []
        for k in range(3):
            G = G @ R[:, n, k]
            axes.append(G @ Jr[:, n, k])
            bone, bone_directions = rest[n, k + 1] - rest[n, k], chains.directions[n, k + 1] - chains.directions[n, k]
            X[:, at + k + 1] = X[:, at + k] + G @ bone
            J[:, at + k + 1, :, 51:] = J[:, at + k, :, 51:] + G @ bone_directions
            for j in range(k + 1):
                column = 6 + 9 * n + 3 * j
                arm = X[:, at + k + 1] - X[:, at + j]
                J[:, at + k + 1, :, column : column + 3] = -se3.hat(arm) @ axes[j]
    J[..., :3] = np.eye(3)
    J[..., 3:6] = -se3.hat(X - chains.wrist)
    return X, J


class PosePrior(NamedTuple):
    """Gaussians and limits for the joints of the five ``FINGERS``.

    Attributes:
        axes: (5, 3, 3, 3) rows: along the bone, the hinge, across both.
        mean: (5, 3, 3) mean rotation vectors, in the hand frame's axes [rad].
        spread: (5, 3, 3) standard deviations of twist, bend and spread [rad].
        limits: (5, 3, 2) minimum and maximum bend [rad].
    """

    axes: Float[ndarray, "5 3 3 3"]
    mean: Float[ndarray, "5 3 3"]
    spread: Float[ndarray, "5 3 3"]
    limits: Float[ndarray, "5 3 2"]

    @staticmethod
    def of(model: HandModel) -> PosePrior:
        """Make the prior of a model, its axes from the rest pose."""
        bone = np.diff(Chains.of(model).points, axis=1)
        bone /= np.linalg.norm(bone, axis=-1, keepdims=True)
        pad = np.array([[0.0, -1.0, 0.0]] * 5)
        pad[FINGERS.index("thumb")] = THUMB_PAD_DIRECTION if model.side == "right" else mirrored(THUMB_PAD_DIRECTION)
        hinge = np.cross(bone, pad[:, None])
        hinge /= np.linalg.norm(hinge, axis=-1, keepdims=True)
        axes = np.stack([bone, hinge, np.cross(bone, hinge)], axis=2)
        bend = np.array([THUMB_BENDS_RAD] + [FINGER_BENDS_RAD] * 4)
        return PosePrior(
            axes=axes,
            mean=bend[..., None] * hinge,
            spread=np.stack([THUMB_SIGMA_RAD] + [FINGER_SIGMA_RAD] * 4),
            limits=np.stack([THUMB_LIMITS] + [FINGER_LIMITS] * 4),
        )

    def residuals(self, q: Float[ndarray, "T 5 3 3"]) -> tuple[Float[ndarray, "T 60"], Float[ndarray, "T 60 45"]]:
        """Compute residuals of poses and their Jacobian: 45 for the Gaussian, 15 for the limits."""
        T = len(q)
        own = np.einsum("fkab,tfkb->tfka", self.axes, q - self.mean) / self.spread
        bend = np.einsum("fkb,tfkb->tfk", self.axes[:, :, 1], q)
        low, high = self.limits[..., 0], self.limits[..., 1]
        beyond = (np.minimum(bend - low, 0.0) + np.maximum(bend - high, 0.0)) / LIMIT_SIGMA_RAD
        J = np.zeros((T, 60, 45))
        scaled = self.axes / self.spread[..., None]
        for joint in range(15):
            f, k = divmod(joint, 3)
            at = slice(3 * joint, 3 * joint + 3)
            J[:, at, at] = scaled[f, k]
            J[:, 45 + joint, at] = (beyond[:, f, k] != 0.0)[:, None] * self.axes[f, k, 1] / LIMIT_SIGMA_RAD
        return np.concatenate([own.reshape(T, 45), beyond.reshape(T, 15)], axis=1), J


class HandUnknowns(Protocol):
    """Hands in several frames, with shared parameters."""

    def retract(self, frames: Float[ndarray, "T 51"], shared: Float[ndarray, "S"]) -> Self:
        """Return the hands after a step."""
        ...


HandsT = TypeVar("HandsT", bound=HandUnknowns)


@dataclass(frozen=True)
class _DescentState(Generic[HandsT]):
    """Hands with their cost and its derivatives (``least_squares.State``)."""

    hands: HandsT
    equations: Callable[[HandsT], Equations]
    value: float
    H: Float[ndarray, "T D D"]
    g: Float[ndarray, "T D"]

    @property
    def cost(self) -> Float[ndarray, "1"]:
        return np.array([self.value])

    def trial(self, active: Int[ndarray, "1"], damping: Float[ndarray, "1"]) -> _DescentState[HandsT]:
        own, common = slice(N_FRAME_PARAMETERS), slice(N_FRAME_PARAMETERS, None)
        shared, frames = BlockArrow.of(self.H[None], self.g[None], shared=common, own=own).step(damping)
        hands = self.hands.retract(frames[0], shared[0])
        return _DescentState(hands, self.equations, *self.equations(hands))

    def accept(
        self, trial: _DescentState[HandsT], active: Int[ndarray, "1"], better: Bool[ndarray, "1"]
    ) -> _DescentState[HandsT]:
        return trial if better[0] else self


def descend(hands: HandsT, equations: Callable[[HandsT], Equations], steps: int) -> tuple[HandsT, float, bool]:
    """Descend from some hands to the nearest minimum; return it, its cost, and whether the descent converged."""
    found = minimise(_DescentState(hands, equations, *equations(hands)), steps, DESCENT_RULES)
    return found.state.hands, found.state.value, found.endings[0] is not Ending.LIMIT
