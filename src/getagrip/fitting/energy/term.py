"""The interface of a term of the energy.

A term is called with ``PosesInCamera`` of B hypotheses in N frames, and returns its value, gradient and Hessian per
frame, in the frame's local 7-vector (``se3``). The solver only sums and solves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray


@dataclass(frozen=True)
class PosesInCamera:
    """The object in the camera frame: ``X_cam = scale * R @ (X_obj - c) + centre``, with c the mesh's centre."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]

    @property
    def size(self) -> int:
        """Length P of a frame's local vector."""
        return 7


@dataclass(frozen=True)
class Quadratic:
    """A term's value [px^2 of the 256-pixel crop] and its derivatives by each frame's local vector.

    That is the object's 7-vector; where the hand moves as well it may be longer (``hand_term``).
    """

    value: Float[ndarray, "B N"]
    g: Float[ndarray, "B N P"]
    H: Float[ndarray, "B N P P"]
    cross: Float[ndarray, "B N P N P"] | None = None
    """The cross-frame Hessian, of terms that tie frames to each other; ``[:, n, :, n]`` is zero, see ``H``."""

    @staticmethod
    def zero(poses: PosesInCamera, size: int = 7) -> Quadratic:
        """Return zeros, for a term to fill in."""
        B, N = poses.centre.shape[:2]
        return Quadratic(np.zeros((B, N)), np.zeros((B, N, size)), np.zeros((B, N, size, size)))

    @staticmethod
    def of_squares(error: Float[ndarray, "B N m"], J: Float[ndarray, "B N m P"], weight: float) -> Quadratic:
        """Return ``weight * |error|^2``, for errors with the Jacobian J by the local vector (Gauss-Newton)."""
        Jt = np.swapaxes(J, -1, -2)
        value = weight * np.sum(error**2, axis=-1)
        return Quadratic(value, 2.0 * weight * (Jt @ error[..., None])[..., 0], 2.0 * weight * (Jt @ J))

    def __add__(self, other: Quadratic) -> Quadratic:
        cross = [a for a in (self.cross, other.cross) if a is not None]
        total = cross[0] + cross[1] if len(cross) == 2 else cross[0] if cross else None
        return Quadratic(self.value + other.value, self.g + other.g, self.H + other.H, total)

    def within(self, size: int, first: int = 0) -> Quadratic:
        """Embed it in a longer vector, of which this one's vector is the part from ``first`` on."""
        B, N, P = self.g.shape
        if size == P:
            return self
        part, cross = slice(first, first + P), None
        g, H = np.zeros((B, N, size)), np.zeros((B, N, size, size))
        g[..., part], H[..., part, part] = self.g, self.H
        if self.cross is not None:
            cross = np.zeros((B, N, size, N, size))
            cross[:, :, part, :, part] = self.cross
        return Quadratic(self.value, g, H, cross)

    def take(self, index: ndarray) -> Quadratic:
        """Return some of the hypotheses."""
        cross = None if self.cross is None else self.cross[index]
        return Quadratic(self.value[index], self.g[index], self.H[index], cross)

    def put(self, index: ndarray, other: Quadratic) -> None:
        """Overwrite some of the hypotheses, in place."""
        self.value[index], self.g[index], self.H[index] = other.value, other.g, other.H
        if self.cross is not None and other.cross is not None:
            self.cross[index] = other.cross


class Term(Protocol):
    """One term of the energy."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        """Evaluate at the poses.

        Where the sum of values over frames exceeds ``bound``, the derivatives, and the values of further frames, may be
        left zero: the solver will reject that step. Where ``bound`` is below zero it will reject it in any case.
        """
        ...


Energy = Callable[[int, Int[ndarray, "n"]], Sequence[Term]]
"""A sum of terms, at a resolution (64, 128 or 256 px) and at some of a clip's frames (their indices)."""


def no_bound(poses: PosesInCamera) -> Float[ndarray, "B"]:
    """Return a bound that asks for the derivatives everywhere."""
    return np.full(len(poses.scale), np.inf)
