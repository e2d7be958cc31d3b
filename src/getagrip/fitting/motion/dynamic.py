"""Dynamic: the object moves freely in the hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.fitting.motion.base import Batch, PosesInHand, Prior, no_prior
from getagrip.geometry import se3
from getagrip.geometry.kernels.rotations import exp_so3


@dataclass(frozen=True)
class Free(Batch):
    """A pose per frame (the paper's Dynamic); S = scale, L = 6."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    log_scale: Float[ndarray, "B"]
    free_scale: bool = False

    def poses(self) -> PosesInHand:
        return PosesInHand(self.R, self.centre, np.exp(self.log_scale))

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Free:
        return replace(self, R=self.R @ R[:, None])

    def with_free_scale(self) -> Free:
        return replace(self, free_scale=True)

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        B, N = self.centre.shape[:2]
        eye = np.eye(7)
        shared = np.broadcast_to(eye[:, 6:] if self.free_scale else eye[:, :0], (B, N, 7, int(self.free_scale)))
        return shared, np.broadcast_to(eye[:, :6], (B, N, 7, 6))

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        return np.zeros(int(self.free_scale), bool), np.arange(6) < 3

    def angles(self) -> None:
        return None

    def prior(self) -> Prior:
        return no_prior(len(self.centre), self.centre.shape[1], 6)

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Free:
        return replace(
            self,
            R=exp_so3(local[..., 3:6]) @ self.R,
            centre=self.centre + local[..., :3],
            log_scale=self.log_scale + (shared[:, 0] if self.free_scale else 0.0),
        )

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Free:
        before = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 2)
        return self.mixed(before, before + 1, (new - old[before]) / (old[before + 1] - old[before]))

    def mixed(self, first: Int[ndarray, "N"], second: Int[ndarray, "N"], share: Float[ndarray, "N"]) -> Free:
        """Interpolate by ``share`` between the first frames and the second; below 0 and above 1, extrapolate."""
        R, centre = self.R[:, first], self.centre[:, first]
        turn = se3.log_so3(self.R[:, second] @ np.swapaxes(R, -1, -2))
        centre = centre + share[:, None] * (self.centre[:, second] - centre)
        return replace(self, R=exp_so3(share[:, None] * turn) @ R, centre=centre)


def interpolate_object_poses(poses: PosesInHand, old: Int[ndarray, "n"], new: Int[ndarray, "m"]) -> PosesInHand:
    """Interpolate poses: rotations along the shortest path, centres along a line; beyond the ends they stay."""
    free = Free(poses.R, poses.centre, np.log(poses.scale)).resampled(old, np.clip(new, old[0], old[-1]))
    return PosesInHand(free.R, free.centre, poses.scale)
