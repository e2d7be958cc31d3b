"""Motion models: how an object may move in a hand. A model maps its parameters to ``T_hand_obj`` of every frame, and
gives the Jacobian of each frame's local 7-vector (``se3``; camera frame) by the parameters.

Parameters are of two kinds: S shared by all frames and L per frame. All arrays have a leading axis of B hypotheses, so
that all starts of a search are solved at once. The object is centred: ``T`` places the mesh's scaled centre.

- ``Fixed`` (the paper's Static): one pose; S = 6 + scale.
- ``Hinge`` (the paper's 1-DoF, Eq. 3): one pose turned by an angle per frame about one line in the hand frame;
  S = 6 + scale + 2 (direction) + 2 (location), L = 1. The angles' common offset and the base pose do the same; the
  solver's damping keeps them still and ``zero_mean`` settles it.
- ``Free`` (the paper's Dynamic): a pose per frame; S = scale, L = 6.
- ``Soft``: one of the first two, and a small deviation per frame under a ridge; L grows by 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.geometry import se3


@dataclass(frozen=True)
class InHand:
    """The posed object in the hand frame: ``X_hand = R @ (scale * (X_obj - c)) + centre``."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]


@dataclass(frozen=True)
class Prior:
    """A quadratic the model puts on its own per-frame parameters: value (B,), gradient (B, N, L), diagonal (L,)."""

    value: Float[ndarray, "B"]
    g: Float[ndarray, "B N L"]
    diagonal: Float[ndarray, "L"]


class Motion(Protocol):
    """What the solver needs of a motion model."""

    def poses(self) -> InHand: ...

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        """Derivatives of the local 7-vectors, as seen in the hand frame, by shared and by per-frame parameters."""
        ...

    def prior(self) -> Prior: ...

    def moved(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Self:
        """The parameters after a step."""
        ...

    def where(self, mask: Bool[ndarray, "B"], other: Self) -> Self:
        """This model's hypotheses where the mask is set, the other's elsewhere."""
        ...

    def take(self, index: ndarray) -> Self:
        """Some of the hypotheses."""
        ...

    def joined(self, other: Self) -> Self:
        """This model's hypotheses, then the other's."""
        ...

    def turned(self, R: Float[ndarray, "B 3 3"]) -> Self:
        """The object turned about its centre by R (object frame), in all frames alike."""
        ...


Core = TypeVar("Core", bound=Motion)


@dataclass(frozen=True)
class _Batch:
    """Hypotheses side by side: every array field, here and in models within, has the same leading axis."""

    def take(self, index: ndarray) -> Self:
        return self._each(lambda v: v[index])

    def joined(self, other: Self) -> Self:
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
            elif isinstance(value, _Batch):
                changed[name] = value._each(change, *rest)
        return replace(self, **changed)


@dataclass(frozen=True)
class Fixed(_Batch):
    """One pose for all frames."""

    R: Float[ndarray, "B 3 3"]
    centre: Float[ndarray, "B 3"]
    log_scale: Float[ndarray, "B"]
    frames: int
    free_scale: bool = False

    def poses(self) -> InHand:
        B, N = len(self.R), self.frames
        R = np.broadcast_to(self.R[:, None], (B, N, 3, 3))
        return InHand(R, np.broadcast_to(self.centre[:, None], (B, N, 3)), np.exp(self.log_scale))

    def turned(self, R: Float[ndarray, "B 3 3"]) -> Fixed:
        return replace(self, R=self.R @ R)

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        J = np.eye(7)[:, : 6 + self.free_scale]
        B, N = len(self.R), self.frames
        return np.broadcast_to(J, (B, N, *J.shape)), np.zeros((B, N, 7, 0))

    def prior(self) -> Prior:
        return _no_prior(len(self.R), self.frames, 0)

    def moved(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Fixed:
        return replace(
            self,
            R=se3.exp_so3(shared[:, 3:6]) @ self.R,
            centre=self.centre + shared[:, :3],
            log_scale=self.log_scale + (shared[:, 6] if self.free_scale else 0.0),
        )


@dataclass(frozen=True)
class Hinge(_Batch):
    """One pose, turned about one line: ``T_hand_obj(n) = rot(angle_n; point, direction) . T_base`` (Eq. 3).

    The paper's equation shows only the line's direction; the authors' code has its location too, and with the axis at
    the grasp and not at the wrist a direction alone is wrong. ``free_location=False`` keeps the line where it is.
    """

    R: Float[ndarray, "B 3 3"]
    centre: Float[ndarray, "B 3"]
    log_scale: Float[ndarray, "B"]
    point: Float[ndarray, "B 3"]
    direction: Float[ndarray, "B 3"]
    angle: Float[ndarray, "B N"]
    free_scale: bool = False
    free_location: bool = True
    ridge: float = 0.0
    """Energy of the angles per rad^2, times 1/2."""

    def _swung(self) -> tuple[Float[ndarray, "B N 3 3"], Float[ndarray, "B N 3"]]:
        turn = se3.exp_so3(self.angle[..., None] * self.direction[:, None])
        arm = turn @ (self.centre - self.point)[:, None, :, None]
        return turn, self.point[:, None] + arm[..., 0]

    def poses(self) -> InHand:
        turn, centre = self._swung()
        return InHand(turn @ self.R[:, None], centre, np.exp(self.log_scale))

    def turned(self, R: Float[ndarray, "B 3 3"]) -> Hinge:
        return replace(self, R=self.R @ R)

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        turn, centre = self._swung()
        B, N = self.angle.shape
        across = tangents(self.direction)
        arm = centre - self.point[:, None]
        sin, cos = np.sin(self.angle)[..., None, None], np.cos(self.angle)[..., None, None]
        # Turning the direction by a turns frame n by sin(angle) a + (1 - cos(angle)) d x a.
        spin = sin * across[:, None] + (1.0 - cos) * np.cross(self.direction[:, None], across)[:, None]
        columns = 6 + self.free_scale + 2 + 2 * self.free_location
        J = np.zeros((B, N, 7, columns))
        J[..., :3, :3] = J[..., 3:6, 3:6] = turn
        if self.free_scale:
            J[..., 6, 6] = 1.0
        k = 6 + self.free_scale
        J[..., :3, k : k + 2] = np.swapaxes(np.cross(spin, arm[:, :, None]), -1, -2)
        J[..., 3:6, k : k + 2] = np.swapaxes(spin, -1, -2)
        if self.free_location:
            J[..., :3, k + 2 :] = np.swapaxes(across, -1, -2)[:, None] - turn @ np.swapaxes(across, -1, -2)[:, None]
        local = np.zeros((B, N, 7, 1))
        local[..., :3, 0] = np.cross(self.direction[:, None], arm)
        local[..., 3:6, 0] = self.direction[:, None]
        return J, local

    def prior(self) -> Prior:
        value = 0.5 * self.ridge * np.sum(self.angle**2, axis=1)
        return Prior(value, self.ridge * self.angle[..., None], np.array([self.ridge]))

    def moved(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Hinge:
        across = tangents(self.direction)
        k = 6 + self.free_scale
        tilt = np.einsum("bk,bki->bi", shared[:, k : k + 2], across)
        turn = se3.exp_so3(np.cross(self.direction, tilt))
        shift = np.einsum("bk,bki->bi", shared[:, k + 2 :], across) if self.free_location else 0.0
        return replace(
            self,
            R=se3.exp_so3(shared[:, 3:6]) @ self.R,
            centre=self.centre + shared[:, :3],
            log_scale=self.log_scale + (shared[:, 6] if self.free_scale else 0.0),
            point=self.point + shift,
            direction=(turn @ self.direction[..., None])[..., 0],
            angle=self.angle + local[..., 0],
        )

    def zero_mean(self) -> Hinge:
        """The same motion, its angles of zero mean, its point the one of the line nearest to the object's centre."""
        mean = self.angle.mean(axis=1)
        turn = se3.exp_so3(mean[:, None] * self.direction)
        centre = self.point + (turn @ (self.centre - self.point)[..., None])[..., 0]
        along = np.sum((centre - self.point) * self.direction, axis=1, keepdims=True)
        return replace(
            self,
            R=turn @ self.R,
            centre=centre,
            angle=self.angle - mean[:, None],
            point=self.point + along * self.direction if self.free_location else self.point,
        )


@dataclass(frozen=True)
class Free(_Batch):
    """A pose per frame."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    log_scale: Float[ndarray, "B"]
    free_scale: bool = False

    def poses(self) -> InHand:
        return InHand(self.R, self.centre, np.exp(self.log_scale))

    def turned(self, R: Float[ndarray, "B 3 3"]) -> Free:
        return replace(self, R=self.R @ R[:, None])

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        B, N = self.centre.shape[:2]
        eye = np.eye(7)
        shared = np.broadcast_to(eye[:, 6:] if self.free_scale else eye[:, :0], (B, N, 7, int(self.free_scale)))
        return shared, np.broadcast_to(eye[:, :6], (B, N, 7, 6))

    def prior(self) -> Prior:
        return _no_prior(len(self.centre), self.centre.shape[1], 6)

    def moved(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Free:
        return replace(
            self,
            R=se3.exp_so3(local[..., 3:6]) @ self.R,
            centre=self.centre + local[..., :3],
            log_scale=self.log_scale + (shared[:, 0] if self.free_scale else 0.0),
        )


@dataclass(frozen=True)
class Soft(_Batch, Generic[Core]):
    """A fixed or hinged motion, and a small deviation per frame under a ridge.

    Deviations (v, w) shift the object and turn it about its centre, in the hand frame:
    ``R_n = exp(w_n) R_core, centre_n = centre_core + v_n``. They take up what the model inside cannot: an object that
    is not quite on a hinge, a hand that the estimator has put a little wrong.
    """

    core: Core
    deviation: Float[ndarray, "B N 6"]
    ridge: tuple[float, float]
    """Energy per m^2 and per rad^2 of deviation, times 1/2."""

    def poses(self) -> InHand:
        held = self.core.poses()
        R = se3.exp_so3(self.deviation[..., 3:]) @ held.R
        return InHand(R, held.centre + self.deviation[..., :3], held.scale)

    def turned(self, R: Float[ndarray, "B 3 3"]) -> Soft[Core]:
        return replace(self, core=self.core.turned(R))

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        shared, angles = self.core.jacobian()
        turn = se3.exp_so3(self.deviation[..., 3:])
        B, N = self.deviation.shape[:2]
        own = np.zeros((B, N, 7, 6))
        own[..., :3, :3] = np.eye(3)
        own[..., 3:6, 3:] = left_jacobian(self.deviation[..., 3:])
        return _turned(turn, shared), np.concatenate([_turned(turn, angles), own], axis=-1)

    def prior(self) -> Prior:
        stiffness = np.repeat(self.ridge, 3)
        pull = stiffness * self.deviation
        inside = self.core.prior()
        return Prior(
            inside.value + 0.5 * np.sum(pull * self.deviation, axis=(1, 2)),
            np.concatenate([inside.g, pull], axis=-1),
            np.concatenate([inside.diagonal, stiffness]),
        )

    def moved(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Soft[Core]:
        core = self.core.moved(shared, local[..., :-6])
        return replace(self, core=core, deviation=self.deviation + local[..., -6:])


def _turned(turn: Float[ndarray, "B N 3 3"], J: Float[ndarray, "B N 7 k"]) -> Float[ndarray, "B N 7 k"]:
    """Local 7-vectors whose rotations are followed by another."""
    return np.concatenate([J[..., :3, :], turn @ J[..., 3:6, :], J[..., 6:, :]], axis=-2)


def tangents(direction: Float[ndarray, "B 3"]) -> Float[ndarray, "B 2 3"]:
    """Two unit vectors across each unit vector."""
    helper = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=-2)


def left_jacobian(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """``exp(w + dw) = exp(left_jacobian(w) @ dw) exp(w)`` to first order."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    small = theta < 1e-4
    safe = np.where(small, 1.0, theta)
    a = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    b = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    W = se3.hat(w)
    return np.eye(3) + a * W + b * (W @ W)


def _no_prior(B: int, N: int, L: int) -> Prior:
    return Prior(np.zeros(B), np.zeros((B, N, L)), np.zeros(L))
