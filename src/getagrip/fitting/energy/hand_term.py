"""Terms on the hand, and the effect of terms on the object on a hand that is unknown as well.

Unknown are the object in the hand, ``T_hand_obj``, and the hand in the camera, ``T_cam_hand``. A term sees both in the
camera (``ObjectWithHand``) and answers by the local vector of each frame, or by a part of it:

    0:7       the object in the camera: v_o, w_o, l_o (``se3``)
    7:14      the hand in the camera: v_h its middle shifts [m], w_h it turns about its middle [rad], l_h logarithm of
              its size
    14:21     the object in the input hand, by a 7-vector in the camera frame

Four kinds of terms follow.

- **On the object in the camera** (masks, smoothness, depth of the object): an ordinary ``Term``, of 7 numbers. It knows
  nothing of the hand. It moves the hand all the same, since ``T_cam_obj = T_cam_hand @ T_hand_obj``: an object held
  still in the hand goes with it, by ``w_o = w_h`` and ``v_o = v_h + w_h x (c_o - c_h)``. That is the chain rule of the
  *parameters*, and the motion's (``motion.MovingHand``), not the term's: a term's derivatives take object and hand as
  free of each other.
- **On the hand in the camera** (2D joints, hand masks, depth of the hand): a ``HandTerm``, of 7 numbers, wrapped in
  ``OnHand``. Any term on a rigid body serves as one, too: to it the hand is a body with a middle.
- **On the object in the hand** (push, pull, contact): a ``Term`` made for the input hand, wrapped in ``InHand``. It
  sees the object relative to the input hand, so that a hand and an object that move together change nothing. If the
  hand grows by s, that object shrinks by s about the hand's middle: distances count in the hand's own measure.
- **On both** (depth up to an unknown scale, which hides which): a ``Term`` that reads ``poses.hand`` itself and answers
  by the first 14 numbers.

Terms that tie frames to each other have a ``Quadratic.cross``, on the hand as on the object. Where the hand is fixed
(poses without one) ``InHand`` is the term within, and ``OnHand`` is a constant, taken as zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic, Term
from getagrip.geometry import se3


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


class HandTerm(Protocol):
    """One term of the energy, on the hand alone."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        """Evaluate by the hand's local vector of 7 numbers; ``bound`` as in ``Term``."""
        ...


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
