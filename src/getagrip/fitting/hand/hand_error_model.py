"""Errors of an input hand, and their fit to evidence under a prior on trackers' errors.

The errors x of a frame (``HandErrors``) change the hand:

    refined T_cam_hand = input T_cam_hand . turn_and_shift(w, s)

w turns the hand about its middle, s shifts it, both in the hand frame. Errors of its size and of the bends of its 15
finger joints only explain the silhouette: without them, wrong fingers would turn the palm, and a hand that is too large
would come nearer. (One silhouette says nothing about depth unless the hand's size is known.) With 2D joints whole
fingers may be off sideways, too; a silhouette alone hardly tells that from a turn of the palm.

The fit (``HandFit``) minimises, over the errors x_n = b + e_n of each frame, b the same in all frames,

    unit * sum_n E_n(x_n) + 1/2 |b / bias|^2 + 1/2 sum_n |e_n / jitter|^2

The solved hand: its poses by all evidence on hand and object, their uncertainty, and the energies that changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.fitting.motion import PosesInHand, interpolate_object_poses
from getagrip.geometry import se3
from getagrip.hands.bending import FINGER_CHAINS, bend_fingers, finger_hinge_axes, finger_spread_axes, finger_weights
from getagrip.least_squares import BlockArrow

ROTATION_ERRORS, TRANSLATION_ERRORS, SIZE_ERROR = slice(0, 3), slice(3, 6), 6
FLEXION_ERRORS, ABDUCTION_ERRORS = slice(7, 22), slice(22, 27)
"""Position of each error among the numbers of a frame: [rad], [m], logarithm, [rad], [rad]."""
ERROR_GROUP_SIZES = (3, 3, 1, 20)
"""Number of turns, shifts, sizes, and finger errors."""
N_RIGID_ERRORS = 7
"""Number of errors without the fingers."""
OnErrors = Callable[[Float[ndarray, "N P"]], tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]]
"""From the errors of each frame to the evidence's value, gradient and Gauss-Newton Hessian."""


@dataclass(frozen=True)
class HandErrors:
    """The input hand in N frames, and its change by errors x (N, P).

    Attributes:
        tracked: the input hand.
        middle: (3,) the point that it turns about, in the hand frame [m].
        weights: (V, 5, 3) weights of the bones on the vertices; None: the fingers stay as in the input, P is
            ``N_RIGID_ERRORS``.
        sideways: whether fingers may turn sideways as well; P is 27, else 22.
    """

    tracked: HandTrack
    middle: Float[ndarray, "3"]
    weights: Float[ndarray, "V 5 3"] | None
    sideways: bool = False

    @staticmethod
    def of(hand: HandTrack) -> HandErrors:
        """Make the rigid errors of a hand."""
        return HandErrors(hand, hand.vertices.mean(axis=(0, 1)), None)

    def with_fingers(self, sideways: bool = False) -> HandErrors:
        """Return the errors with the fingers' among them; only the rigid ones for a hand without joints."""
        if self.tracked.joints is None:
            return self
        return replace(self, weights=finger_weights(self.tracked), sideways=sideways)

    @property
    def size(self) -> int:
        """Number P of errors of a frame."""
        if self.weights is None:
            return N_RIGID_ERRORS
        return ABDUCTION_ERRORS.stop if self.sideways else FLEXION_ERRORS.stop

    def take(self, index: Int[ndarray, "n"]) -> HandErrors:
        """Return the hand at some of its frames."""
        return replace(self, tracked=self.tracked.take(index))

    def T_cam_hand(self, x: Float[ndarray, "N P"]) -> Float[ndarray, "N 4 4"]:
        """Return the poses of the refined hand."""
        R = se3.exp_so3(x[:, ROTATION_ERRORS])
        return self.tracked.T_cam_hand @ se3.rigid(R, self.middle + x[:, TRANSLATION_ERRORS] - R @ self.middle)

    def surface(self, x: Float[ndarray, "N P"]) -> tuple[Float[ndarray, "N V 3"], Float[ndarray, "N 21 3"] | None]:
        """Return vertices and joints in the refined hand's frame, with the size and the bends of the errors."""
        vertices, joints = self.tracked.vertices, self.tracked.joints
        if self.weights is not None and joints is not None:
            vertices, joints = bend_fingers(vertices, joints, self.weights, *_finger_errors(x))
        size = np.exp(x[:, SIZE_ERROR, None, None])
        vertices = self.middle + size * (vertices - self.middle)
        return vertices, None if joints is None else self.middle + size * (joints - self.middle)

    def jacobian(
        self,
        x: Float[ndarray, "N P"],
        vertices: Float[ndarray, "N V 3"],
        joints: Float[ndarray, "N 21 3"] | None,
        nearest: Int[ndarray, "N M"],
        along: Float[ndarray, "N M 3"],
    ) -> Float[ndarray, "N M P"]:
        """Differentiate the motion of M points of the ``surface`` by the errors.

        ``nearest`` is the vertex that each point moves with, ``along`` the direction of the derivative, in the camera
        frame.
        """
        turn = se3.exp_so3(x[:, ROTATION_ERRORS])
        in_input = along @ self.tracked.T_cam_hand[:, :3, :3]
        X = np.take_along_axis(vertices, nearest[..., None], axis=1)
        arm = (X - self.middle) @ np.swapaxes(turn, 1, 2)
        J = np.empty((*nearest.shape, x.shape[1]))
        J[..., ROTATION_ERRORS] = np.cross(arm, in_input) @ se3.left_jacobian(x[:, ROTATION_ERRORS])
        J[..., TRANSLATION_ERRORS] = in_input
        J[..., SIZE_ERROR] = np.sum(arm * in_input, axis=-1)
        if self.weights is None or joints is None or self.tracked.joints is None:
            return J
        in_hand = in_input @ turn
        moment = np.cross(X, in_hand)

        def turned(axis: Float[ndarray, "N 3"], through: Float[ndarray, "N k 3"]) -> Float[ndarray, "N M k"]:
            # Turning X about the axis a through p moves it by a x (X - p), along n by a . (X x n) - (a x p) . n.
            offset = in_hand @ np.swapaxes(np.cross(axis[:, None], through), 1, 2)
            return np.asarray(moment @ axis[..., None] - offset)

        # A finger's hinges are parallel, so bends do not turn them; the turn sideways, which comes last, does.
        aside = finger_spread_axes(self.tracked.joints)
        axes, sideways = finger_hinge_axes(self.tracked.joints), _finger_errors(x)[1]
        if sideways is not None:
            axes = (se3.exp_so3(sideways[..., None] * aside) @ axes[..., None])[..., 0]
        beyond = np.cumsum(self.weights[..., ::-1], axis=-1)[..., ::-1][nearest]  # what moves with a joint
        for f, chain in enumerate(FINGER_CHAINS):
            first = FLEXION_ERRORS.start + 3 * f
            J[..., first : first + 3] = beyond[..., f, :] * turned(axes[:, f], joints[:, chain[:3]])
            if sideways is not None:
                J[..., ABDUCTION_ERRORS.start + f] = (
                    beyond[..., f, 0] * turned(aside[:, f], joints[:, chain[:1]])[..., 0]
                )
        return J


def _finger_errors(x: Float[ndarray, "N P"]) -> tuple[Float[ndarray, "N 5 3"], Float[ndarray, "N 5"] | None]:
    """Return bends, and turns sideways if the errors have them."""
    return x[:, FLEXION_ERRORS].reshape(-1, 5, 3), x[:, ABDUCTION_ERRORS] if x.shape[1] > FLEXION_ERRORS.stop else None


@dataclass(frozen=True)
class AssumedErrors:
    """Assumed standard deviations of b and of e_n, and the weight of a unit of evidence."""

    bias: Float[ndarray, "Q"]
    jitter: Float[ndarray, "Q"]
    unit: float = 1.0

    @staticmethod
    def of(bias: Sequence[float], jitter: Sequence[float], unit: float = 1.0) -> AssumedErrors:
        """Make them of deviations of turns [rad], shifts [m], size (logarithm), bends and turns sideways [rad]."""
        return AssumedErrors(np.repeat(bias, ERROR_GROUP_SIZES), np.repeat(jitter, ERROR_GROUP_SIZES), unit)


@dataclass(frozen=True)
class HandFit:
    """Errors with the cost's value and derivatives at them (``least_squares.State``, of one problem)."""

    seen: OnErrors
    assumed: AssumedErrors
    shared: Float[ndarray, "P"]
    own: Float[ndarray, "N P"]
    value: Float[ndarray, "N"] = field(repr=False)
    g: Float[ndarray, "N P"] = field(repr=False)
    H: Float[ndarray, "N P P"] = field(repr=False)

    @staticmethod
    def of(
        seen: OnErrors, assumed: AssumedErrors, own: Float[ndarray, "N P"], shared: Float[ndarray, "P"] | None = None
    ) -> HandFit:
        """Evaluate the cost at some errors."""
        shared = np.zeros(own.shape[1]) if shared is None else shared
        return HandFit(seen, assumed, shared, own, *seen(shared + own))

    @property
    def errors(self) -> Float[ndarray, "N P"]:
        """Errors of each frame."""
        return self.shared + self.own

    @property
    def cost(self) -> Float[ndarray, "1"]:
        P = len(self.shared)
        prior = np.sum((self.shared / self.assumed.bias[:P]) ** 2) + np.sum((self.own / self.assumed.jitter[:P]) ** 2)
        return np.array([self.assumed.unit * float(self.value.sum()) + 0.5 * prior])

    def trial(self, active: Int[ndarray, "n"], damping: Float[ndarray, "n"]) -> HandFit:
        P, unit = len(self.shared), self.assumed.unit
        bias, jitter = self.assumed.bias[:P] ** -2.0, self.assumed.jitter[:P] ** -2.0
        arrow = BlockArrow.of(unit * self.H[None], self.g[None], slice(P), slice(P))
        arrow = replace(arrow, g_s=unit * arrow.g_s, g_l=unit * arrow.g_l)
        arrow = arrow.plus(np.diag(bias), bias * self.shared, np.diag(jitter), jitter * self.own)
        shared, own = arrow.step(damping)
        return HandFit.of(self.seen, self.assumed, self.own + own[0], self.shared + shared[0])

    def accept(self, trial: HandFit, active: Int[ndarray, "n"], better: Bool[ndarray, "n"]) -> HandFit:
        return trial if better.all() else self


N_ALTERNATIVE_DIRECTIONS, MIN_POINT_VARIANCE_M2 = 3, 1e-12
"""Number of directions of a hand's alternatives; minimum squared motion of points by a standard deviation [m^2]."""


@dataclass(frozen=True)
class SolvedHand:
    """A hand that was solved together with its object.

    Attributes:
        T_cam_hand: (N, 4, 4) its poses.
        covariance: (6, 6) of the error that all frames share, in the hand frame: shift of the hand's middle [m], turn
            about the middle [rad]. By curvature, without other minima.
        energy: energy of each kind of evidence, before and after [px^2 of the 256-pixel crop].
        differing: fraction of the hand's visible pixels that differ from its silhouette.
    """

    T_cam_hand: Float[ndarray, "N 4 4"]
    covariance: Float[ndarray, "6 6"]
    energy: Mapping[str, tuple[float, float]]
    differing: float

    def alternatives(
        self, points: Float[ndarray, "P 3"], middle: Float[ndarray, "3"], apart: float
    ) -> Float[ndarray, "M 4 4"]:
        """Return alternative hand poses, either way along the ``N_ALTERNATIVE_DIRECTIONS`` least certain directions.

        Args:
            points: points in the hand, from its middle [m].
            middle: the hand's middle, in the hand frame [m].
            apart: motion of these points, root mean square [m].

        Returns:
            Poses in the hand frame, in pairs, the least certain direction first.
        """
        certain, axes = np.linalg.eigh(self.covariance)
        root, moved = axes * np.sqrt(np.maximum(certain, 0.0)), rigid_point_jacobian(points)
        spread, axes = np.linalg.eigh(root.T @ np.einsum("pij,pik->jk", moved, moved) @ root / len(points))
        x = (apart * root @ axes[:, ::-1] / np.sqrt(np.maximum(spread[::-1], MIN_POINT_VARIANCE_M2))).T
        x = np.stack([x, -x], axis=1)[:N_ALTERNATIVE_DIRECTIONS].reshape(-1, 6)
        R = se3.exp_so3(x[:, 3:])
        return se3.rigid(R, middle + x[:, :3] - R @ middle)

    def spread(self, points: Float[ndarray, "P 3"]) -> float:
        """Compute the standard deviation of points in the hand, from its middle, that its shared error leaves [m]."""
        moved = rigid_point_jacobian(points)
        return float(np.sqrt(np.einsum("pij,jk,pik->p", moved, self.covariance, moved).mean()))

    def __str__(self) -> str:
        place, turn = (np.sqrt(np.trace(part)) for part in (self.covariance[:3, :3], self.covariance[3:, 3:]))
        evidence = ", ".join(f"{name} {before:.0f} to {after:.0f}" for name, (before, after) in self.energy.items())
        return (
            "hand and object were solved together: the hand is known to about "
            f"{1e3 * place:.0f} mm and {np.degrees(turn):.0f} degrees; energies: {evidence}"
        )


def rigid_point_jacobian(points: Float[ndarray, "P 3"]) -> Float[ndarray, "P 3 6"]:
    """Differentiate points about a body's centre by the body's shift and turn."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -se3.hat(points)], axis=-1)


def interpolate_solved_hand(
    T_input: Float[ndarray, "T 4 4"], T_found: Float[ndarray, "n 4 4"], at: ndarray
) -> Float[ndarray, "T 4 4"]:
    """Interpolate the corrections of the hand's poses in the frames ``at`` to every frame."""
    C = (se3.inverse(T_input[at]) @ T_found)[None]
    corrections = PosesInHand(C[..., :3, :3], C[..., :3, 3], np.ones(1))
    between = interpolate_object_poses(corrections, at, np.arange(len(T_input)))
    T_cam_hand = T_input @ se3.rigid(between.R[0], between.centre[0])
    T_cam_hand[at] = T_found
    return np.asarray(T_cam_hand)
