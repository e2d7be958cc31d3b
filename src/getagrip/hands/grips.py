"""Priors by object category: typical grips, and the variation of size and shape.

Directions and points are in the frame of the category's mesh: z up, the front or the handle at +x
(``synthetic.objects``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Real
from numpy import ndarray

from getagrip.geometry import se3


@dataclass(frozen=True)
class HoldFrame:
    """A frame at the palm or the fingertips of the right hand, in the hand frame; see ``Grip``."""

    at: tuple[float, float, float]
    into: tuple[float, float, float]
    aside: tuple[float, float, float]


HOLD_FRAMES = {
    "palm": HoldFrame(at=(0.018, -0.02, 0.0), into=(0.0, -1.0, 0.0), aside=(-0.2, 0.0, 0.98)),
    "pinch": HoldFrame(at=(0.004, -0.058, 0.022), into=(-0.10, -1.0, 0.0), aside=(-1.0, 0.10, -0.15)),
}


@dataclass(frozen=True)
class Grip:
    """A grip: a point and directions in the object's frame; directions of any length.

    Attributes:
        hold: palm, or pinch between the fingertips.
        at: the point at the palm, or between the pads [m].
        into: the direction away from the hand.
        aside: palm: the direction towards the thumb's side; pinch: from the thumb to the fingers.
    """

    hold: Literal["palm", "pinch"]
    at: tuple[float, float, float]
    into: tuple[float, float, float]
    aside: tuple[float, float, float]

    @property
    def R_hand_obj(self) -> Float[ndarray, "3 3"]:
        """The object's rotation in the frame of a right hand."""
        hold = HOLD_FRAMES[self.hold]
        T_hand_grip = frame_from_axes(np.array(hold.into), np.array(hold.aside), np.array(hold.at))
        T_obj_grip = frame_from_axes(np.array(self.into), np.array(self.aside), np.array(self.at))
        return T_hand_grip[:3, :3] @ T_obj_grip[:3, :3].T


def frame_from_axes(
    into: Real[ndarray, "3"], aside: Real[ndarray, "3"], at: Real[ndarray, "3"]
) -> Float[ndarray, "4 4"]:
    """Make a frame with x along ``into`` and y as near to ``aside`` as possible."""
    x = np.asarray(into, dtype=float) / np.linalg.norm(into)
    z = np.cross(x, aside)
    z /= np.linalg.norm(z)
    return se3.rigid(np.stack([x, np.cross(z, x), z], axis=-1), np.asarray(at, dtype=float))


@dataclass(frozen=True)
class CategoryPrior:
    """Typical grips of a category's objects, and the variation of their size and shape.

    Attributes:
        grips: the most frequent grips.
        rarer: further grips, for clips of varied grasps.
        spread: standard deviation of the logarithm of the size, among objects in kitchens: a coarse assumption.
        stretch: standard deviation of stretches along x, y and z; None: ``fitting.stages.mesh_deformation``'s.
        bend: standard deviation of other deformations, likewise; small for flat sides.
        opens_up: True for a vessel or bottle: grasps with its opening on the little finger's side are rare.
        revolved: True for a body of revolution about z, without its handles, whose profile varies.
    """

    grips: tuple[Grip, ...]
    rarer: tuple[Grip, ...] = ()
    spread: float = 0.25
    stretch: float | None = None
    bend: float | None = None
    opens_up: bool = False
    revolved: bool = False


_ROUND_GRIP = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, 1))
_ROUND_THUMB_DOWN_GRIP = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, -1))
_BAR_GRIP = Grip("palm", (0, 0, 0), (0, 0.5, -1), (-1, 0, 0))
_BAR_FROM_BELOW_GRIP = Grip("palm", (0, 0, 0), (0, -0.6, 1), (-1, 0, 0))


def _rim_grip(radius: float, height: float) -> Grip:
    """Make the grip of a vessel by its rim, the thumb inside."""
    return Grip("pinch", (radius, 0, height), (-0.25, 0, -1), (1, 0, 0))


CATEGORY_PRIORS: dict[str, CategoryPrior] = {
    "bottle": CategoryPrior(
        (Grip("palm", (0, 0, -0.02), (1, 0, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.06), (1, 0, 0), (0, 0, 1)), Grip("palm", (0, 0, 0.03), (1, 0, 0), (0, 0, -1))),
        spread=0.5,
        stretch=0.2,  # slim, squat or flat
        opens_up=True,
        revolved=True,
    ),
    "bowl": CategoryPrior((Grip("pinch", (0.072, 0, 0.055), (-0.25, 0, -1), (1, 0, 0)),), opens_up=True, revolved=True),
    "can": CategoryPrior((_ROUND_GRIP,), (_ROUND_THUMB_DOWN_GRIP,), revolved=True),
    "cup": CategoryPrior(
        (Grip("pinch", (0.058, 0, 0.042), (-1, 0, 0), (0, -1, 0)),),
        (Grip("pinch", (0, -0.042, 0.055), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
        spread=0.15,
        opens_up=True,
        revolved=True,
    ),
    "glass": CategoryPrior(
        (_ROUND_GRIP,), (_ROUND_THUMB_DOWN_GRIP, _rim_grip(0.036, 0.055)), opens_up=True, revolved=True
    ),
    "mug": CategoryPrior(
        (
            Grip("palm", (0.077, 0, 0.05), (-1, 0, 0), (0, 0, 1)),  # by the handle
            Grip("palm", (0, 0, 0.05), (0.3, 1, 0), (0, 0, 1)),  # around the body, the handle beyond the fingers
        ),
        (Grip("pinch", (0, -0.039, 0.085), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
        spread=0.15,
        opens_up=True,
        revolved=True,
    ),
    "pan": CategoryPrior((_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,), opens_up=True, revolved=True),
    "plate": CategoryPrior((Grip("pinch", (0.09, 0, 0.016), (-1, 0, 0), (0, 0, -1)),), spread=0.2, revolved=True),
    "saucepan": CategoryPrior((_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,), opens_up=True, revolved=True),
    "box": CategoryPrior(
        (Grip("palm", (0, -0.06, 0), (0, 1, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.085), (0, 0, -1), (0, 1, 0)),),  # from above
        spread=0.5,
        bend=0.005,
    ),
    "capsule_machine": CategoryPrior((Grip("palm", (-0.03, 0, 0), (1, 0, 0), (0, 0, 1)),)),
    "espresso_machine": CategoryPrior(
        (
            Grip("palm", (0.145, 0, 0.013), (0, 0.5, -1), (-1, 0, 0)),  # by the filter's handle
            Grip("palm", (-0.055, 0, -0.01), (1, 0, 0), (0, 0, 1)),  # by the column
        )
    ),
    "kettle": CategoryPrior((Grip("palm", (0.127, 0, 0.085), (-1, 0, 0), (0, 0, 1)),), opens_up=True, revolved=True),
    "ketchup": CategoryPrior((Grip("palm", (0, 0, 0.02), (1, 0, 0), (0, 0, 1)),)),
    "laptop": CategoryPrior((Grip("pinch", (0.1, 0, 0), (-1, 0, 0), (0, 0, -1)),), spread=0.15, bend=0.005),
    "microwave": CategoryPrior((Grip("palm", (0.151, 0.078, 0), (-1, -0.35, 0), (0, 0, 1)),)),
    "mixer": CategoryPrior((Grip("palm", (0, 0, 0.084), (0, 0.5, -1), (1, 0, 0)),)),
    "notebook": CategoryPrior((Grip("pinch", (0.055, 0, 0), (-1, 0, 0), (0, 0, -1)),)),
    "phone": CategoryPrior((Grip("palm", (0, -0.01, 0), (0, 0, 1), (0, 1, 0)),), spread=0.12, bend=0.005),
    "scissors": CategoryPrior((Grip("pinch", (-0.095, 0, 0), (1, 0, 0), (0, 0, -1)),)),
    "spoon": CategoryPrior((Grip("pinch", (-0.06, 0, 0.009), (1, 0, 0), (0, 0, -1)),)),
    "waffle_iron": CategoryPrior((_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,)),
    "book": CategoryPrior((Grip("pinch", (0.06, 0, 0), (-1, 0, 0), (0, 0, -1)),), spread=0.4, bend=0.005),
    "jar": CategoryPrior((_ROUND_GRIP,), spread=0.4, stretch=0.2, revolved=True),
    "pitcher": CategoryPrior((Grip("palm", (0.102, 0, 0.1), (-1, 0, 0), (0, 0, 1)),), opens_up=True, revolved=True),
    "french_press": CategoryPrior(
        (Grip("palm", (0.092, 0, 0.085), (-1, 0, 0), (0, 0, 1)),), opens_up=True, revolved=True
    ),
    "jug": CategoryPrior((Grip("palm", (0.085, 0, 0.065), (-1, 0, 0), (0, 0, 1)),), opens_up=True, revolved=True),
    "spray_bottle": CategoryPrior((Grip("palm", (-0.014, 0, 0.185), (1, 0, 0), (0, 0, 1)),), opens_up=True),
    "watering_can": CategoryPrior(
        (Grip("palm", (0.14, 0, 0.105), (-1, 0, -0.3), (-0.3, 0, 1)),), opens_up=True, revolved=True
    ),
    "hammer": CategoryPrior((Grip("palm", (0, 0, -0.1), (0, 1, 0), (0, 0, 1)),)),
    "knife": CategoryPrior((Grip("palm", (-0.09, 0, 0), (0, 0.3, -1), (1, 0, 0)),)),
    "remote": CategoryPrior((Grip("palm", (0, -0.03, 0), (0, 0, 1), (0, 1, 0)),), bend=0.01),
    "screwdriver": CategoryPrior((Grip("palm", (0, 0, -0.06), (1, 0, 0), (0, 0, 1)),)),
}
"""Priors of the nine categories of EPIC-Grasps, ARCTIC's categories, and others."""
