"""Soft: another motion, with a small deviation per frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.motion.base import Batch, Motion, PosesInHand, Prior
from getagrip.geometry import se3
from getagrip.geometry.kernels.rotations import exp_so3, left_jacobian

Core = TypeVar("Core", bound=Motion)


@dataclass(frozen=True)
class Soft(Batch, Generic[Core]):
    """A fixed or hinged motion, and a small deviation per frame under a ridge; L grows by 6.

    Deviations (v, w) shift the object and turn it about its centre, in the hand frame:
    ``R_n = exp(w_n) R_core, centre_n = centre_core + v_n``. They explain small departures from the model within: an
    object that is not quite on a hinge, a hand whose estimate is a little wrong.

    Attributes:
        core: the motion to deviate from.
        deviation: (B, N, 6) translation [m] and rotation vector [rad] of each frame, in the hand frame.
        ridge: energy per m^2 and per rad^2 of deviation, times 1/2 [px^2].
    """

    core: Core
    deviation: Float[ndarray, "B N 6"]
    ridge: tuple[float, float]

    @staticmethod
    def around(core: Core, poses: PosesInHand, ridge: tuple[float, float]) -> Soft[Core]:
        """Split poses into a core motion and the deviations from it."""
        inner = core.poses()
        w = se3.log_so3(poses.R @ np.swapaxes(inner.R, -1, -2))
        return Soft(core, np.concatenate([poses.centre - inner.centre, w], axis=-1), ridge)

    def poses(self) -> PosesInHand:
        core_poses = self.core.poses()
        R = exp_so3(self.deviation[..., 3:]) @ core_poses.R
        return PosesInHand(R, core_poses.centre + self.deviation[..., :3], core_poses.scale)

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Soft[Core]:
        return replace(self, core=self.core.rotated(R))

    def with_free_scale(self) -> Soft[Core]:
        return replace(self, core=self.core.with_free_scale())

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        shared, angles = self.core.jacobian()
        B, N = self.deviation.shape[:2]
        turned, own = np.empty(shared.shape), np.zeros((B, N, 7, angles.shape[-1] + 6))
        turn, left = exp_so3(self.deviation[..., 3:]), left_jacobian(self.deviation[..., 3:])
        _soft_jacobian(*map(np.ascontiguousarray, (turn, left, shared, angles)), turned, own)
        return turned, own

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        shared, angles = self.core.lengths()
        return shared, np.concatenate([angles, np.arange(6) < 3])

    def angles(self) -> Float[ndarray, "B N"] | None:
        return self.core.angles()

    def prior(self) -> Prior:
        stiffness = np.repeat(self.ridge, 3)
        pull = stiffness * self.deviation
        inside = self.core.prior()
        return Prior(
            inside.value + 0.5 * np.sum(pull * self.deviation, axis=(1, 2)),
            np.concatenate([inside.g, pull], axis=-1),
            np.concatenate([inside.diagonal, stiffness]),
        )

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Soft[Core]:
        core = self.core.retract(shared, local[..., :-6])
        return replace(self, core=core, deviation=self.deviation + local[..., -6:])

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Soft[Core]:
        between = [[np.interp(new, old, column) for column in d.T] for d in self.deviation]
        return replace(self, core=self.core.resampled(old, new), deviation=np.swapaxes(between, 1, 2))


@kernel("f4 f4 f4 f4 f4 f4")
def _soft_jacobian(turn, left, shared, angles, turned, own):
    """Turn the rows of rotation of the core's Jacobians, and append those of the deviations to each frame's own."""
    B, N = turn.shape[:2]
    L = angles.shape[3]
    for b in range(B):
        for n in range(N):
            _turn_rotation(turn[b, n], shared[b, n], turned[b, n])
            _turn_rotation(turn[b, n], angles[b, n], own[b, n])
            for i in range(3):
                own[b, n, i, L + i] = 1.0
                for j in range(3):
                    own[b, n, 3 + i, L + 3 + j] = left[b, n, i, j]


@kernel()
def _turn_rotation(turn, J, out):
    for j in range(J.shape[1]):
        for i in range(3):
            out[i, j] = J[i, j]
            out[3 + i, j] = turn[i, 0] * J[3, j] + turn[i, 1] * J[4, j] + turn[i, 2] * J[5, j]
        out[6, j] = J[6, j]
