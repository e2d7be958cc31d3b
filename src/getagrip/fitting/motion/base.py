"""The interface of a motion model: a map from parameters to ``T_hand_obj`` of every frame, with its Jacobian.

The Jacobian is that of each frame's local 7-vector (``se3``) by the parameters. Parameters are of two kinds: S shared
by all frames and L per frame. All arrays have a leading axis of B hypotheses, so that all hypotheses of a search are
solved at once. The object is centred: ``T`` places the mesh's scaled centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.geometry import se3


@dataclass(frozen=True)
class Batch:
    """Hypotheses side by side: all array fields, including those of models within, have the same leading axis."""

    def take(self, index: ndarray) -> Self:
        return self._each(lambda v: v[index])

    def concatenate(self, other: Self) -> Self:
        return self._each(lambda mine, theirs: np.concatenate([mine, theirs]), other)

    def updated(self, rows: Int[ndarray, "n"], other: Self) -> Self:
        """Replace some of the hypotheses by the other's, of which it has as many."""

        def update(mine: ndarray, theirs: ndarray) -> ndarray:
            out = mine.copy()
            out[rows] = theirs
            return out

        return self._each(update, other)

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
    """The posed object in the hand frame: ``X_hand = R @ (scale * (X_obj - c)) + centre``.

    ``hand`` is the moved hand where it moves (``MovingHand``); the object stays in the input hand's frame.
    """

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]
    hand: HandPoses | None = field(default=None, kw_only=True)


class HandFrame(Protocol):
    """Properties of a hand that all hypotheses share."""

    @property
    def middle(self) -> Float[ndarray, "3"]:
        """The point that the hand turns and grows about, in the hand frame [m]."""
        ...


@dataclass(frozen=True)
class HandPoses(Batch):
    """The moved hand in the input hand's frame: ``X_input = R @ (scale * (X_hand - middle)) + centre``.

    ``grasped``: the object's poses if the input hand grasped it as the moved hand does.
    """

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]
    grasped: PosesInHand
    frame: HandFrame


def hand_object_transforms(poses: PosesInHand, centre: Float[ndarray, "3"]) -> Float[ndarray, "B N 4 4"]:
    """Return ``T_hand_obj`` of poses about the mesh's centre, which lies at ``centre`` in its own frame."""
    R, scale = poses.R, poses.scale[:, None, None]
    return se3.rigid(R, poses.centre - scale * (R @ centre))


def transform_poses(poses: PosesInHand, T: Float[ndarray, "N 4 4"]) -> PosesInHand:
    """Transform poses to another frame by the hand's poses T in it; the inverse leads back."""
    R, t, hand = T[:, :3, :3], T[:, :3, 3], poses.hand
    if hand is not None:
        centre = (R @ hand.centre[..., None])[..., 0] + t
        hand = replace(hand, R=R @ hand.R, centre=centre, grasped=transform_poses(hand.grasped, T))
    return PosesInHand(R @ poses.R, (R @ poses.centre[..., None])[..., 0] + t, poses.scale, hand=hand)


@dataclass(frozen=True)
class Prior:
    """A motion model's quadratic energy of its own parameters.

    Attributes:
        value: its value.
        g: gradient by the per-frame parameters.
        diagonal: Hessian by these, (L,) the same in all frames or (N, L).
        g_shared, diagonal_shared: the same by the shared parameters; None: they have no prior.
        cross: Hessian between frames, zero within each; None: frames are independent.
    """

    value: Float[ndarray, "B"]
    g: Float[ndarray, "B N L"]
    diagonal: Float[ndarray, "*N L"]
    g_shared: Float[ndarray, "B S"] | None = None
    diagonal_shared: Float[ndarray, "S"] | None = None
    cross: Float[ndarray, "N L N L"] | None = None

    @property
    def H(self) -> Float[ndarray, "*N L L"]:
        """Hessian by the per-frame parameters."""
        return self.diagonal[..., None] * np.eye(self.diagonal.shape[-1])


class Motion(Protocol):
    """The methods of a motion model that solver and search use."""

    def poses(self) -> PosesInHand: ...

    def jacobian(self) -> tuple[Float[ndarray, "B N P S"], Float[ndarray, "B N P L"]]:
        """Return derivatives of the local vectors, as seen in the hand frame, by shared and by per-frame parameters.

        P is 7, or 21 where the hand moves (``energy.term``).
        """
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
        """Choose this model's hypotheses where the mask is set, else the other's."""
        ...

    def take(self, index: ndarray) -> Self:
        """Return some of the hypotheses."""
        ...

    def updated(self, rows: Int[ndarray, "n"], other: Self) -> Self:
        """Replace some of the hypotheses by the other's, of which it has as many."""
        ...

    def concatenate(self, other: Self) -> Self:
        """Return this model's hypotheses, then the other's."""
        ...

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Self:
        """Rotate the object about its centre by R (object frame), in all frames alike."""
        ...

    def with_free_scale(self) -> Self:
        """Return the motion with its scale as a parameter."""
        ...

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Self:
        """Interpolate the motion at other frames (indices into a clip).

        Per-frame parameters are interpolated linearly, rotations along the shortest path.
        """
        ...


def no_prior(B: int, N: int, L: int) -> Prior:
    """Return the prior of a model that has none."""
    return Prior(np.zeros(B), np.zeros((B, N, L)), np.zeros(L))
