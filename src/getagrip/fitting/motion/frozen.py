"""Frozen: another motion whose shared parameters are fixed; only each frame's own are free."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.fitting.motion.base import Batch, Motion, PosesInHand, Prior

Core = TypeVar("Core", bound=Motion)


@dataclass(frozen=True)
class Frozen(Batch, Generic[Core]):
    """A motion with free per-frame parameters only: S = 0, L as in ``core``."""

    core: Core

    def poses(self) -> PosesInHand:
        return self.core.poses()

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Frozen[Core]:
        return replace(self, core=self.core.rotated(R))

    def with_free_scale(self) -> Frozen[Core]:
        return replace(self, core=self.core.with_free_scale())

    def jacobian(self) -> tuple[Float[ndarray, "B N P S"], Float[ndarray, "B N P L"]]:
        shared, local = self.core.jacobian()
        return shared[..., :0], local

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        shared, local = self.core.lengths()
        return shared[:0], local

    def angles(self) -> Float[ndarray, "B N"] | None:
        return self.core.angles()

    def prior(self) -> Prior:
        return replace(self.core.prior(), g_shared=None, diagonal_shared=None)

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Frozen[Core]:
        still = np.zeros((len(local), len(self.core.lengths()[0])))
        return replace(self, core=self.core.retract(still, local))

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Frozen[Core]:
        return replace(self, core=self.core.resampled(old, new))
