"""1-DoF: the object turns about one line that is fixed in the hand (Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray

from getagrip.fitting.motion.base import Batch, PosesInHand, Prior
from getagrip.fitting.motion.static import Fixed
from getagrip.geometry.kernels.rotations import cross, exp_so3

ANGLE_RIDGE = 400.0
"""Stiffness of a hinge's angles [px^2 per rad^2]: negligible where a silhouette shows the angle, enough to keep a
bottle from spinning about its own axis, which no silhouette shows."""


@dataclass(frozen=True)
class Hinge(Batch):
    """One pose, turned about one line: ``T_hand_obj(n) = rot(angle_n; point, direction) . T_base`` (Eq. 3).

    The paper's equation shows only the line's direction; the authors' code has its location too, and the best
    axis seldom passes through the origin of the hand frame. ``free_location=False`` keeps the line where it is.

    S = 6 + scale + 2 (direction) + 2 (location), L = 1. A common offset of the angles and a turn of the base pose are
    equivalent; the solver's damping fixes the two, and ``zero_mean`` removes the offset.

    Attributes:
        R: (B, 3, 3) rotation of the base pose, object to hand.
        centre: (B, 3) the object's centre in the base pose, in the hand frame [m].
        log_scale: (B,) natural logarithm of the scale.
        point: (B, 3) a point on the axis, in the hand frame [m].
        direction: (B, 3) unit vector along the axis, in the hand frame.
        angle: (B, N) angle about the axis in each frame [rad].
        free_scale: whether the scale is a parameter.
        free_location: whether the point is a parameter.
        ridge: energy of the angles per rad^2, times 1/2.
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

    @staticmethod
    def nearest(
        base: Fixed, deviation: Float[ndarray, "B N 6"], free_location: bool, anchor: Float[ndarray, "3"]
    ) -> Hinge:
        """Fit the hinge nearest to a relaxed fit: principal direction of its rotation vectors, angles along it.

        ``deviation`` holds each frame's shift [m] and rotation vector [rad] from ``base`` (``Soft``). With
        ``free_location`` the line's location follows from the shifts, with a ridge towards the object's centre;
        otherwise the line passes through ``anchor`` (hand frame, m).
        """
        v, w = deviation[..., :3], deviation[..., 3:]
        mean = w.mean(axis=1, keepdims=True)
        _, _, Vt = np.linalg.svd(w - mean)
        direction = Vt[:, 0]
        angle = np.sum((w - mean) * direction[:, None], axis=-1)
        offset = v - v.mean(axis=1, keepdims=True)
        centre = base.centre + v.mean(axis=1)
        if free_location:
            # v_n = angle_n d x (centre - point): least squares for the arm, against 5 degrees of noise per frame.
            arm = cross(np.sum(angle[..., None] * offset, axis=1), direction)
            arm /= np.sum(angle**2, axis=1)[:, None] + v.shape[1] * np.radians(5.0) ** 2
            length = np.linalg.norm(arm, axis=1, keepdims=True)
            point = centre - arm * np.minimum(1.0, 0.1 / np.maximum(length, 1e-9))
        else:
            point = np.broadcast_to(anchor, centre.shape).copy()
        R = exp_so3(mean[:, 0]) @ base.R
        return Hinge(R, centre, base.log_scale, point, direction, angle, base.free_scale, free_location, ANGLE_RIDGE)

    @property
    def base(self) -> Fixed:
        """The base pose, in all frames."""
        return Fixed(self.R, self.centre, self.log_scale, self.angle.shape[1], self.free_scale)

    def _swung(self) -> tuple[Float[ndarray, "B N 3 3"], Float[ndarray, "B N 3"]]:
        turn = exp_so3(self.angle[..., None] * self.direction[:, None])
        arm = turn @ (self.centre - self.point)[:, None, :, None]
        return turn, self.point[:, None] + arm[..., 0]

    def poses(self) -> PosesInHand:
        turn, centre = self._swung()
        return PosesInHand(turn @ self.R[:, None], centre, np.exp(self.log_scale))

    def rotated(self, R: Float[ndarray, "B 3 3"]) -> Hinge:
        return replace(self, R=self.R @ R)

    def with_free_scale(self) -> Hinge:
        return replace(self, free_scale=True)

    def jacobian(self) -> tuple[Float[ndarray, "B N 7 S"], Float[ndarray, "B N 7 L"]]:
        turn, centre = self._swung()
        B, N = self.angle.shape
        orthogonal = tangents(self.direction)
        arm = centre - self.point[:, None]
        sin, cos = np.sin(self.angle)[..., None, None], np.cos(self.angle)[..., None, None]
        # Turning the direction by a turns frame n by sin(angle) a + (1 - cos(angle)) d x a.
        spin = sin * orthogonal[:, None] + (1.0 - cos) * cross(self.direction[:, None], orthogonal)[:, None]
        columns = 6 + self.free_scale + 2 + 2 * self.free_location
        J = np.zeros((B, N, 7, columns))
        J[..., :3, :3] = J[..., 3:6, 3:6] = turn
        if self.free_scale:
            J[..., 6, 6] = 1.0
        k = 6 + self.free_scale
        J[..., :3, k : k + 2] = np.swapaxes(cross(spin, arm[:, :, None]), -1, -2)
        J[..., 3:6, k : k + 2] = np.swapaxes(spin, -1, -2)
        if self.free_location:
            shift = np.swapaxes(orthogonal, -1, -2)[:, None]
            J[..., :3, k + 2 :] = shift - turn @ shift
        local = np.zeros((B, N, 7, 1))
        local[..., :3, 0] = cross(self.direction[:, None], arm)
        local[..., 3:6, 0] = self.direction[:, None]
        return J, local

    def lengths(self) -> tuple[Bool[ndarray, "S"], Bool[ndarray, "L"]]:
        k = np.arange(8 + self.free_scale + 2 * self.free_location)
        return (k < 3) | (k >= 8 + self.free_scale), np.zeros(1, bool)

    def angles(self) -> Float[ndarray, "B N"]:
        return self.angle

    def prior(self) -> Prior:
        value = 0.5 * self.ridge * np.sum(self.angle**2, axis=1)
        return Prior(value, self.ridge * self.angle[..., None], np.array([self.ridge]))

    def retract(self, shared: Float[ndarray, "B S"], local: Float[ndarray, "B N L"]) -> Hinge:
        orthogonal = tangents(self.direction)
        k = 6 + self.free_scale
        tilt = np.einsum("bk,bki->bi", shared[:, k : k + 2], orthogonal)
        turn = exp_so3(cross(self.direction, tilt))
        shift = np.einsum("bk,bki->bi", shared[:, k + 2 :], orthogonal) if self.free_location else 0.0
        return replace(
            self,
            R=exp_so3(shared[:, 3:6]) @ self.R,
            centre=self.centre + shared[:, :3],
            log_scale=self.log_scale + (shared[:, 6] if self.free_scale else 0.0),
            point=self.point + shift,
            direction=(turn @ self.direction[..., None])[..., 0],
            angle=self.angle + local[..., 0],
        )

    def zero_mean(self) -> Hinge:
        """Return the motion with angles of zero mean and the line's point nearest to the object's centre."""
        mean = self.angle.mean(axis=1)
        turn = exp_so3(mean[:, None] * self.direction)
        centre = self.point + (turn @ (self.centre - self.point)[..., None])[..., 0]
        along = np.sum((centre - self.point) * self.direction, axis=1, keepdims=True)
        return replace(
            self,
            R=turn @ self.R,
            centre=centre,
            angle=self.angle - mean[:, None],
            point=self.point + along * self.direction if self.free_location else self.point,
        )

    def resampled(self, old: Int[ndarray, "M"], new: Num[ndarray, "N"]) -> Hinge:
        return replace(self, angle=np.stack([np.interp(new, old, angle) for angle in self.angle]))


def tangents(direction: Float[ndarray, "B 3"]) -> Float[ndarray, "B 2 3"]:
    """Return two unit vectors orthogonal to each unit vector, and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    first = cross(direction, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross(direction, first)], axis=-2)
