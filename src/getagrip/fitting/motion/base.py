"""The interface of a motion model: a map from parameters to ``T_hand_obj`` of every frame, with its Jacobian.

The Jacobian is that of each frame's local 7-vector (``se3``) by the parameters. Parameters are of two kinds: S shared
by all frames and L per frame. All arrays have a leading axis of B hypotheses, so that all hypotheses of a search are
solved at once. The object is centred: ``T`` places the mesh's scaled centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.geometry import se3


@dataclass(frozen=True)
class Batch:
    """Hypotheses side by side: every array field, here and in models within, has the same leading axis."""

    def take(self, index: ndarray) -> Self:
        return self._each(lambda v: v[index])

    def concatenate(self, other: Self) -> Self:
        return self._each(lambda mine, theirs: np.concatenate([mine, theirs]), other)

    def where(self, mask: Bool[ndarray, "B"], other: Self) -> Self:
        def choose(mine: ndarray, theirs: ndarray) -> ndarray:
            return np.asarray(np.where(mask.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs))

        return self._each(choose, other)

    def _each(self, change: Callable[..., ndarray], *others: Self) -> Self:
        changed: dict[str, object] = {}
        for name, value in vars(self).items():
            rest = [getattr(o, name) for o in others]
            if isinstance(value, ndarray):
                changed[name] = change(value, *rest)
            elif isinstance(value, Batch):
                changed[name] = value._each(change, *rest)
        return replace(self, **changed)


@dataclass(frozen=True)
class PosesInHand(Batch):
    """The posed object in the hand frame: ``X_hand = R @ (scale * (X_obj - c)) + centre``."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]


def placed(poses: PosesInHand, centre: Float[ndarray, "3"]) -> Float[ndarray, "B N 4 4"]:
    """Return ``T_hand_obj`` of poses about the mesh's centre, which lies at ``centre`` in its own frame."""
    R, scale = poses.R, poses.scale[:, None, None]
    return se3.rigid(R, poses.centre - scale * (R @ centre))


def moved(poses: PosesInHand, T: Float[ndarray, "N 4 4"]) -> PosesInHand:
    """Transform poses to another frame, given the hand's pose in it; the inverse leads back."""
    R = T[:, :3, :3]
    return PosesInHand(R @ poses.R, (R @ poses.centre[..., None])[..., 0] + T[:, :3, 3], poses.scale)


@dataclass(frozen=True)
class Prior:
    """A quadratic the model puts on its own per-frame parameters: value (B,), gradient (B, N, L), diagonal (L,)."""

    value: Float[ndarray, "B"]
    g: Float[ndarray, "B N L"]
    diagonal: Float[ndarray, "L"]


class Motion(Protocol):
    """The methods of a motion model that solver and search use."""

    def poses(self) -> PosesInHand: ...

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        """Differentiate the local 7-vectors, as seen in the hand frame, by shared and by per-frame parameters."""
        ...

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        """Mark the shared and the per-frame parameters in metres; the others are radians or logarithms."""
        ...

    def angles(self) -> Float[ndarray, "B N"] | None:
        """Return the angles about the latent axis [rad], where the model has one."""
        ...

    def prior(self) -> Prior: ...

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Self:
        """Return the parameters after a step."""
        ...

    def where(self, mask: Bool[ndarray, "B"], other: Self) -> Self:
        """Return this model's hypotheses where the mask is set, the other's elsewhere."""
        ...

    def take(self, index: ndarray) -> Self:
        """Return some of the hypotheses."""
        ...

    def concatenate(self, other: Self) -> Self:
        """Return this model's hypotheses, then the other's."""
        ...

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Self:
        """Rotate the object about its centre by R (object frame), in all frames alike."""
        ...

    def with_free_scale(self) -> Self:
        """Return the motion with its scale a parameter."""
        ...

    def resampled(self, old: Int[ndarray, "M"], new: Int[ndarray, "N"]) -> Self:
        """Interpolate the motion at other frames (indices into a clip).

        Per-frame parameters are interpolated linearly, rotations along the shortest path.
        """
        ...


def no_prior(B: int, N: int, L: int) -> Prior:
    """Return the prior of a model that has none."""
    return Prior(np.zeros(B), np.zeros((B, N, L)), np.zeros(L))
