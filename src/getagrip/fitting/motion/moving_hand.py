"""Moving hand: a motion of the object in a hand whose pose is estimated as well, under a prior on its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.fitting.motion.base import Batch, HandPoses, Motion, PosesInHand, Prior
from getagrip.geometry import se3
from getagrip.geometry.kernels.rotations import exp_so3, left_jacobian

Core = TypeVar("Core", bound=Motion)

SHIFT_SLICE, TURN_SLICE, RAY_SHIFT_INDEX = slice(0, 3), slice(3, 6), 6
"""Positions of a frame's errors: shift in the hand frame [m], turn about the hand's middle [rad], shift along the
camera's ray through the middle [m]. The constant part has the logarithm of the hand's size besides, as its last."""


@dataclass(frozen=True)
class HandPrior:
    """The prior on a hand's errors: a constant error of the clip, and one of each frame.

    Attributes:
        middle: (3,) the point that the hand turns and grows about, in the hand frame [m].
        rays: (T, 3) unit vectors from the camera to the middle, in the hand frame, in all frames of a clip.
        frames: (N,) the motion's frames (indices into ``rays``).
        constant: (8,) standard deviations of the constant errors; zero keeps one fixed.
        own: (7,) standard deviations of each frame's own errors, without the size.
        weight: twice the energy of one standard deviation [px^2].
        memory: number of frames after which the correlation of own errors has fallen to 1/e; zero: independent.
    """

    middle: Float[ndarray, "3"]
    rays: Float[ndarray, "T 3"]
    frames: Int[ndarray, "N"]
    constant: Float[ndarray, "C"]
    own: Float[ndarray, "D"]
    weight: float
    memory: float = 0.0

    @staticmethod
    def of(
        hand: HandTrack, constant: Float[ndarray, "C"], own: Float[ndarray, "D"], weight: float, memory: float = 0.0
    ) -> HandPrior:
        """Make the prior of a clip's hand, at all of its frames."""
        middle = hand.vertices.mean(axis=(0, 1))
        ray = se3.transform(hand.T_cam_hand, middle[None])[:, 0]
        rays = ((ray / np.linalg.norm(ray, axis=1, keepdims=True))[:, None] @ hand.T_cam_hand[:, :3, :3])[:, 0]
        return HandPrior(middle, rays, np.arange(len(rays)), constant, own, weight, memory)

    def at(self, frames: Int[ndarray, "N"]) -> HandPrior:
        """Take some frames of the clip."""
        return replace(self, frames=frames)

    def widened(self, constant: Float[ndarray, "C"], own: Float[ndarray, "N D"], freedom: float) -> HandPrior:
        """Widen it to errors of shift, turn and depth, each to Student's t with ``freedom`` degrees of freedom (EM)."""
        wider = self.constant.copy(), self.own.copy()
        for deviation, errors in zip(wider, (constant[None], own), strict=True):
            for part in (SHIFT_SLICE, TURN_SLICE, slice(RAY_SHIFT_INDEX, RAY_SHIFT_INDEX + 1)):
                squares = (errors[:, part] / deviation[part]) ** 2
                deviation[part] *= np.sqrt(max(1.0, (freedom + squares.sum()) / (freedom + squares.size)))
        return replace(self, constant=wider[0], own=wider[1])

    @cached_property
    def coupling(self) -> Float[ndarray, "N N"]:
        """Inverse correlation of a frame's own errors with the other frames' (Ornstein-Uhlenbeck), tridiagonal."""
        N = len(self.frames)
        if self.memory == 0.0:
            return np.eye(N)
        a = np.exp(-np.diff(self.frames) / self.memory)
        root = np.eye(N) - np.diag(a, k=-1)
        innovation = np.concatenate([[1.0], 1.0 - a**2])
        return np.asarray(root.T @ (root / innovation[:, None]))

    @cached_property
    def stiffness(self) -> tuple[Float[ndarray, "C"], Float[ndarray, "D"]]:
        """Inverse variances times ``weight``; zero for fixed parameters."""
        with np.errstate(divide="ignore"):
            pair = [np.where(sd > 0.0, self.weight / sd**2, 0.0) for sd in (self.constant, self.own)]
        return pair[0], pair[1]


@dataclass(frozen=True)
class MovingHand(Batch, Generic[Core]):
    """A motion in the hand, and errors x_n of the hand: ``T_hand = shift(d_n r_n) . turn_and_shift(w_n, s_n)``.

    Poses are relative to the input hand, as in all motions, with the moved hand's poses beside them; with the input
    ``T_cam_hand`` they give both in the camera. ``core`` is the motion in the moved hand. S grows by the free constant
    errors, L by the frames' own: x_n = constant + own_n.

    Attributes:
        core: the motion in the moved hand.
        constant: (B, 8) errors that all frames share, the logarithm of the size last.
        own: (B, N, 7) each frame's own errors.
        assumed: the errors' prior.
    """

    core: Core
    constant: Float[ndarray, "B C"]
    own: Float[ndarray, "B N D"]
    assumed: HandPrior

    @staticmethod
    def around(core: Core, assumed: HandPrior) -> MovingHand[Core]:
        """Put a motion in the input hand."""
        B, N = len(core.poses().scale), len(assumed.frames)
        return MovingHand(core, np.zeros((B, len(assumed.constant))), np.zeros((B, N, len(assumed.own))), assumed)

    def _hand(self) -> HandPoses:
        x, assumed = self.constant[:, None, :-1] + self.own, self.assumed
        shift = x[..., SHIFT_SLICE] + x[..., RAY_SHIFT_INDEX, None] * assumed.rays[assumed.frames]
        size = np.exp(self.constant[:, -1])
        grasped = self.core.poses()
        arm = (grasped.centre - assumed.middle) / size[:, None, None]
        grasped = PosesInHand(grasped.R, assumed.middle + arm, grasped.scale / size)
        return HandPoses(exp_so3(x[..., TURN_SLICE]), assumed.middle + shift, size, grasped, assumed)

    def poses(self) -> PosesInHand:
        grasped, hand = self.core.poses(), self._hand()
        arm = hand.R @ (grasped.centre - self.assumed.middle)[..., None]
        return PosesInHand(hand.R @ grasped.R, hand.centre + arm[..., 0], grasped.scale, hand=hand)

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> MovingHand[Core]:
        return replace(self, core=self.core.rotated(R))

    def with_free_scale(self) -> MovingHand[Core]:
        return replace(self, core=self.core.with_free_scale())

    def jacobian(self) -> tuple[Float[ndarray, "B N P S"], Float[ndarray, "B N P L"]]:
        shared, local = self.core.jacobian()
        hand, object_ = self._hand(), self.poses()
        B, N = hand.centre.shape[:2]
        size = np.zeros((B, N, 21, 1))
        size[..., 14:17, 0], size[..., [13, 20], 0] = self.assumed.middle - hand.grasped.centre, [1.0, -1.0]
        J = np.zeros((B, N, 21, 7))
        J[..., 7:10, SHIFT_SLICE], J[..., 7:10, RAY_SHIFT_INDEX] = np.eye(3), self.assumed.rays[self.assumed.frames]
        J[..., 10:13, TURN_SLICE] = left_jacobian((self.constant[:, None, :-1] + self.own)[..., TURN_SLICE])
        # An object at rest in the hand moves with the hand.
        J[..., :3, :] = J[..., 7:10, :] - se3.hat(object_.centre - hand.centre) @ J[..., 10:13, :]
        J[..., 3:6, :] = J[..., 10:13, :]
        constant, own = self._free()
        of_constant = np.concatenate([J, size], axis=-1)[..., constant]
        return (
            np.concatenate([_object_motion_jacobian(hand, shared), of_constant], axis=-1),
            np.concatenate([_object_motion_jacobian(hand, local), J[..., own]], axis=-1),
        )

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        shared, local = self.core.lengths()
        constant, own = self._free()
        k = np.arange(len(constant))
        metres = (k < 3) | (k == RAY_SHIFT_INDEX)
        return np.concatenate([shared, metres[constant]]), np.concatenate([local, metres[:-1][own]])

    def angles(self) -> Float[ndarray, "B N"] | None:
        return self.core.angles()

    def prior(self) -> Prior:
        inside, assumed = self.core.prior(), self.assumed
        stiff_constant, stiff_own = assumed.stiffness
        constant, own = self._free()
        coupling, (B, N) = assumed.coupling, self.own.shape[:2]
        pull, pull_own = stiff_constant * self.constant, stiff_own * (coupling @ self.own)
        value = 0.5 * np.sum(pull * self.constant, axis=1) + 0.5 * np.sum(pull_own * self.own, axis=(1, 2))
        S, L = len(self.core.lengths()[0]), inside.g.shape[-1]
        diagonal = np.broadcast_to(inside.diagonal, (N, L)), np.diag(coupling)[:, None] * stiff_own[own]
        cross = None
        if assumed.memory > 0.0:
            cross = np.zeros((N, L + len(stiff_own[own]), N, L + len(stiff_own[own])))
            for k, stiffness in enumerate(stiff_own[own], start=L):
                cross[:, k, :, k] = stiffness * (coupling - np.diag(np.diag(coupling)))
        return Prior(
            inside.value + value,
            np.concatenate([inside.g, pull_own[..., own]], axis=-1),
            np.concatenate(diagonal, axis=-1),
            np.concatenate([np.zeros((B, S)), pull[:, constant]], axis=-1),
            np.concatenate([np.zeros(S), stiff_constant[constant]]),
            cross,
        )

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> MovingHand[Core]:
        constant, own = self._free()
        S, L = shared.shape[-1] - np.count_nonzero(constant), local.shape[-1] - np.count_nonzero(own)
        moved = self.constant.copy(), self.own.copy()
        moved[0][:, constant] += shared[:, S:]
        moved[1][..., own] += local[..., L:]
        core = self.core.retract(shared[:, :S], local[..., :L])
        return replace(self, core=core, constant=moved[0], own=moved[1])

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> MovingHand[Core]:
        between = [[np.interp(new, old, column) for column in x.T] for x in self.own]
        core, own = self.core.resampled(old, new), np.swapaxes(np.array(between), 1, 2)
        return replace(self, core=core, own=own, assumed=self.assumed.at(new))

    def _free(self) -> tuple[Bool[ndarray, "C"], Bool[ndarray, "D"]]:
        return self.assumed.constant > 0.0, self.assumed.own > 0.0


def _object_motion_jacobian(hand: HandPoses, J: Float[ndarray, "B N 7 k"]) -> Float[ndarray, "B N P k"]:
    """Transform local 7-vectors of the object in the moved hand to local 21-vectors, with the hand fixed."""
    v, w, scale = J[..., :3, :], J[..., 3:6, :], J[..., 6:, :]
    zero = np.zeros((*J.shape[:2], 7, J.shape[-1]))
    return np.concatenate([hand.R @ v, hand.R @ w, scale, zero, v / hand.scale[:, None, None, None], w, scale], axis=-2)
