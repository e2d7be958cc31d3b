"""Static: the object does not move in the hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.fitting.motion.base import Batch, PosesInHand, Prior, no_prior
from getagrip.geometry.kernels.rotations import exp_so3


@dataclass(frozen=True)
class Fixed(Batch):
    """One pose for all frames (the paper's Static); S = 6 + scale, L = 0."""

    R: Float[ndarray, "B 3 3"]
    centre: Float[ndarray, "B 3"]
    log_scale: Float[ndarray, "B"]
    frames: int
    free_scale: bool = False

    def poses(self) -> PosesInHand:
        B, N = len(self.R), self.frames
        R = np.broadcast_to(self.R[:, None], (B, N, 3, 3))
        return PosesInHand(R, np.broadcast_to(self.centre[:, None], (B, N, 3)), np.exp(self.log_scale))

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Fixed:
        return replace(self, R=self.R @ R)

    def with_free_scale(self) -> Fixed:
        return replace(self, free_scale=True)

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        J = np.eye(7)[:, : 6 + self.free_scale]
        B, N = len(self.R), self.frames
        return np.broadcast_to(J, (B, N, *J.shape)), np.zeros((B, N, 7, 0))

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        return np.arange(6 + self.free_scale) < 3, np.zeros(0, bool)

    def angles(self) -> None:
        return None

    def prior(self) -> Prior:
        return no_prior(len(self.R), self.frames, 0)

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Fixed:
        return replace(
            self,
            R=exp_so3(shared[:, 3:6]) @ self.R,
            centre=self.centre + shared[:, :3],
            log_scale=self.log_scale + (shared[:, 6] if self.free_scale else 0.0),
        )

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Fixed:
        return replace(self, frames=len(new))
