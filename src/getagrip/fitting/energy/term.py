"""Terms of the energy: the bodies that they see, and the value and derivatives that they answer by.

A term is called with the bodies' poses in the camera, of B hypotheses in N frames, and returns its value, gradient and
Gauss-Newton Hessian per frame, by the frame's local vector (``se3``). The solver only sums and solves.

Unknown are the object in the hand, ``T_hand_obj``, and, for an estimated hand, the hand in the camera, ``T_cam_hand``.
With a moving hand (``ObjectWithHand``) a frame's local vector has 21 numbers, and each term answers by a part of it:

    0:7       the object in the camera: v_o, w_o, l_o (``se3``)
    7:14      the hand in the camera: v_h its middle shifts [m], w_h it turns about its middle [rad], l_h logarithm of
              its size
    14:21     the object in the input hand, by a 7-vector in the camera frame

Four kinds of terms follow.

- **On the object in the camera** (masks, smoothness, depth of the object): an ordinary ``Term``, of 7 numbers. It knows
  nothing of the hand. It moves the hand all the same, since ``T_cam_obj = T_cam_hand @ T_hand_obj``: an object that
  rests in the hand goes with it, by ``w_o = w_h`` and ``v_o = v_h + w_h x (c_o - c_h)``. That is the chain rule of the
  *parameters*, and the motion's (``motion.MovingHand``), not the term's: a term's derivatives take object and hand as
  free of each other.
- **On the hand in the camera** (2D joints, hand masks, depth of the hand): a ``HandTerm``, of 7 numbers, wrapped in
  ``OnHand``. Any term on a rigid body serves as one, too: to it the hand is a body with a middle.
- **On the object in the hand** (push, pull, contact): a ``Term`` made for the input hand, wrapped in ``InHand``. It
  sees the object relative to the input hand, so that a hand and an object that move together change nothing. If the
  hand grows by s, that object shrinks by s about the hand's middle: distances count in the hand's own measure.
- **On both** (depth up to an unknown scale, which hides which): a ``Term`` that reads ``poses.hand`` itself and answers
  by the first 14 numbers.

Terms that tie frames to each other have a ``Quadratic.cross`` or ``ties``, on the hand as on the object. Where the hand
is fixed (poses without one) ``InHand`` is the term within, and ``OnHand`` is a constant, taken as zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry import se3


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
class HandInCamera(PosesInCamera):
    """The hand in the camera frame: ``X_cam = scale * R @ (X_hand - middle) + centre``.

    Attributes:
        middle: (3,) the point that the hand turns and grows about, in the hand frame [m].
    """

    middle: Float[ndarray, "3"]

    @property
    def T_cam_hand(self) -> Float[ndarray, "B N 4 4"]:
        """Poses of the hand; its size is not in them."""
        return se3.rigid(self.R, self.centre - self.R @ self.middle)


@dataclass(frozen=True)
class ObjectWithHand(PosesInCamera):
    """The object in the camera frame, and the hand that moves with it.

    ``in_hand`` is the object relative to the input hand, in the camera frame.
    """

    hand: HandInCamera
    in_hand: PosesInCamera

    @property
    def size(self) -> int:
        return 21


@dataclass(frozen=True)
class Ties:
    """Hessians between M pairs of frames, of a term that ties few of the frames to each other.

    A dense Hessian between N frames grows by N^2. The solver uses these by what frames share, and bounds them from
    above by what is each frame's own: ``2 x y <= x^2 + y^2``.

    Attributes:
        first, second: the two frames of each pair.
        block: Hessian by the first and the second frame's local vector.
        bound: what each frame's own Hessian is raised by in place of ``block``.
    """

    first: Int[ndarray, "M"]
    second: Int[ndarray, "M"]
    block: Float[ndarray, "B M P P"]
    bound: Float[ndarray, "B N P P"]

    def within(self, size: int, first: int) -> Ties:
        """Embed the pairs' vectors in vectors of ``size`` numbers, their own from ``first`` on."""
        P = self.block.shape[-1]
        block, bound = (np.zeros((*part.shape[:2], size, size)) for part in (self.block, self.bound))
        block[..., first : first + P, first : first + P] = self.block
        bound[..., first : first + P, first : first + P] = self.bound
        return Ties(self.first, self.second, block, bound)

    def dense(self) -> Float[ndarray, "B N P N P"]:
        """Return the Hessian between all frames."""
        B, N, P = self.bound.shape[:3]
        cross = np.zeros((B, N, P, N, P))
        cross[:, self.first, :, self.second] = np.swapaxes(self.block, 0, 1)
        cross[:, self.second, :, self.first] = np.swapaxes(np.swapaxes(self.block, 0, 1), -1, -2)
        return cross


@dataclass(frozen=True)
class Quadratic:
    """A term's value [px^2 of the 256-pixel crop] and its derivatives by each frame's local vector, of P numbers."""

    value: Float[ndarray, "B N"]
    g: Float[ndarray, "B N P"]
    H: Float[ndarray, "B N P P"]
    cross: Float[ndarray, "B N P N P"] | None = None
    """Hessian between frames, of terms that tie frames to each other; ``[:, n, :, n]`` is zero, see ``H``."""
    ties: Ties | None = None
    """Hessian between pairs of frames, of a term that ties few of them."""

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
        if self.ties is not None and other.ties is not None:
            cross.append(other.ties.dense())
        total = reduce(np.add, cross) if cross else None
        ties = other.ties if self.ties is None else self.ties
        return Quadratic(self.value + other.value, self.g + other.g, self.H + other.H, total, ties)

    @property
    def between_frames(self) -> Float[ndarray, "B N P N P"] | None:
        """The Hessian between frames, of pairs as well."""
        if self.ties is None:
            return self.cross
        return self.ties.dense() if self.cross is None else self.cross + self.ties.dense()

    def within(self, size: int, first: int = 0) -> Quadratic:
        """Embed the quadratic in a vector of ``size`` numbers, its own from ``first`` on."""
        B, N, P = self.g.shape
        if size == P:
            return self
        part, cross = slice(first, first + P), None
        g, H = np.zeros((B, N, size)), np.zeros((B, N, size, size))
        g[..., part], H[..., part, part] = self.g, self.H
        if self.cross is not None:
            cross = np.zeros((B, N, size, N, size))
            cross[:, :, part, :, part] = self.cross
        return Quadratic(self.value, g, H, cross, None if self.ties is None else self.ties.within(size, first))

    def take(self, index: ndarray) -> Quadratic:
        """Return some of the hypotheses."""
        cross, ties = None if self.cross is None else self.cross[index], self.ties
        if ties is not None:
            ties = replace(ties, block=ties.block[index], bound=ties.bound[index])
        return Quadratic(self.value[index], self.g[index], self.H[index], cross, ties)

    def put(self, index: ndarray, other: Quadratic) -> None:
        """Overwrite some of the hypotheses, in place."""
        self.value[index], self.g[index], self.H[index] = other.value, other.g, other.H
        if self.cross is not None and other.cross is not None:
            self.cross[index] = other.cross
        if self.ties is not None and other.ties is not None:
            self.ties.block[index], self.ties.bound[index] = other.ties.block, other.ties.bound


class Term(Protocol):
    """One term of the energy."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        """Evaluate at the poses.

        Where the values' sum over frames exceeds ``bound``, the derivatives and the values of further frames may be
        left zero: the solver will reject that step. Where ``bound`` is below zero it rejects the step in any case.
        """
        ...


Energy = Callable[[int, Int[ndarray, "n"]], Sequence[Term]]
"""A sum of terms, at a resolution (64, 128 or 256 px) and at some of a clip's frames (their indices)."""


def no_bound(poses: PosesInCamera) -> Float[ndarray, "B"]:
    """Return a bound that asks for the derivatives everywhere."""
    return np.full(len(poses.scale), np.inf)


class HandTerm(Protocol):
    """One term of the energy, on the hand alone."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        """Evaluate by the hand's local vector of 7 numbers; ``bound`` as in ``Term``."""
        ...


HandEnergy = Callable[[int, Int[ndarray, "n"]], Sequence[HandTerm]]
"""A sum of terms on the hand, at a resolution and at some of a clip's frames, as ``Energy`` on the object."""


@dataclass(frozen=True)
class OnHand:
    """A term on the hand, as a term of the energy of object and hand."""

    term: HandTerm

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        if not isinstance(poses, ObjectWithHand):
            return Quadratic.zero(poses)
        return self.term(poses.hand, bound).within(poses.size, first=7)


@dataclass(frozen=True)
class InHand:
    """A term made for the input hand, applied to the object in the moved hand."""

    term: Term

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        if not isinstance(poses, ObjectWithHand):
            return self.term(poses, bound)
        return self.term(poses.in_hand, bound).within(poses.size, first=14)


@dataclass(frozen=True)
class Terms:
    """Terms of a modality at a problem's frames, made when an energy is evaluated.

    Attributes:
        object: terms on the object, or on object and hand; None: none.
        hand: terms on the hand alone, which count where the hand is unknown as well; None: none.
    """

    object: Energy | None = None
    hand: HandEnergy | None = None
