"""Terms on the hand, and what terms on the object say of a hand that is unknown as well.

Unknown are the object in the hand, ``T_hand_obj``, and the hand in the camera, ``T_cam_hand``. A term sees both in the
camera (``ObjectWithHand``) and answers by the local vector of each frame, of P = 14 + F numbers:

    0:3  v_o   the object's centre shifts [m]             7:10  v_h   the hand's middle shifts [m]
    3:6  w_o   the object turns about its centre [rad]   10:13  w_h   the hand turns about its middle [rad]
    6    l_o   logarithm of the object's scale           13     l_h   logarithm of the hand's size
                                                         14:    fingers: F modes, for whoever built the term

all in the camera frame, both 7-vectors as ``se3`` has them. Four kinds of terms follow.

- **On the object in the camera** (masks, smoothness, depth of the object): an ordinary ``Term``, of 7 numbers. It knows
  nothing of the hand. It moves the hand all the same, since ``T_cam_obj = T_cam_hand @ T_hand_obj``: an object held
  still in the hand goes with it, by ``w_o = w_h`` and ``v_o = v_h + w_h x (c_o - c_h)``. That is the chain rule of the
  *parameters*, and the motion's (``motion.MovingHand``), not the term's: a term's derivatives take object and hand as
  free of each other.
- **On the hand in the camera** (2D joints, hand masks, depth of the hand): a ``HandTerm``, of 7 + F numbers, wrapped in
  ``OnHand``. Any term on a rigid body serves as one, too: to it the hand is a body with a middle.
- **On the object in the hand** (push, pull, contact): a ``Term`` made for the hand as given, wrapped in ``InHand``. It
  is evaluated at the object as the given hand would see it, so that a hand and an object that move together change
  nothing.
- **On both** (depth up to an unknown scale, which hides which): a ``Term`` that reads ``poses.hand`` itself and answers
  by all P numbers.

Terms that tie frames to each other have a ``Quadratic.cross``, on the hand as on the object. Where the hand is held
(poses without one) ``InHand`` is the term within, and ``OnHand`` is a constant, taken as zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic, Term
from getagrip.geometry import se3


@dataclass(frozen=True)
class HandInCamera(PosesInCamera):
    """The hand in the camera frame: ``X_cam = scale * R @ (X_hand - middle) + centre``.

    Attributes:
        modes: (B, N, F) how much of each of F modes the fingers have; F = 0 where they keep their bends.
        middle: (3,) the point that the hand turns and grows about, in the hand frame [m].
        given: (N, 4, 4) ``T_cam_hand`` as it was given.
    """

    modes: Float[ndarray, "B N F"]
    middle: Float[ndarray, "3"]
    given: Float[ndarray, "N 4 4"]

    @property
    def size(self) -> int:
        return 7 + self.modes.shape[-1]

    @property
    def T_cam_hand(self) -> Float[ndarray, "B N 4 4"]:
        """Poses of the hand; its size is not in them."""
        return se3.rigid(self.R, self.centre - self.R @ self.middle)


@dataclass(frozen=True)
class ObjectWithHand(PosesInCamera):
    """The object in the camera frame, and the hand that moves with it."""

    hand: HandInCamera

    @property
    def size(self) -> int:
        return 7 + self.hand.size


class HandTerm(Protocol):
    """One term of the energy, on the hand alone."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        """Evaluate by the hand's local vector of 7 + F numbers; ``bound`` as in ``Term``."""
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
        hand = self.term(poses.hand, bound)
        return hand.within(7 + hand.g.shape[-1], first=7).within(poses.size)


@dataclass(frozen=True)
class InHand:
    """A term made for the given hand, on the object as the moved hand has it.

    With M the turn from the moved hand back to the given one, and s its size, the term sees the object turned by M, its
    centre at ``M (c_o - c_h) / s`` from the given hand's middle, and its scale divided by s: distances count in the
    hand's own measure. Fingers are those given.
    """

    term: Term

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        if not isinstance(poses, ObjectWithHand):
            return self.term(poses, bound)
        hand = poses.hand
        R_given = hand.given[:, :3, :3]
        M, offset = R_given @ np.swapaxes(hand.R, -1, -2), poses.centre - hand.centre
        shrink = M / hand.scale[:, None, None, None]
        arm = (shrink @ offset[..., None])[..., 0]
        home = R_given @ hand.middle + hand.given[:, :3, 3]
        J = np.zeros((*offset.shape[:2], 7, poses.size))
        J[..., :3, :3], J[..., 3:6, 3:6], J[..., 6, 6] = shrink, M, 1.0
        # Moving the hand moves the object in the hand the other way.
        J[..., :3, 7:10], J[..., :3, 10:13], J[..., :3, 13] = -shrink, shrink @ se3.hat(offset), -arm
        J[..., 3:6, 10:13], J[..., 6, 13] = -M, -1.0
        seen = PosesInCamera(np.ascontiguousarray(M @ poses.R), arm + home, poses.scale / hand.scale)
        return self.term(seen, bound).by(J)
