"""Motion models: how an object may move in a hand, a file each.

``Fixed`` (the paper's Static), ``Hinge`` (the paper's 1-DoF, Eq. 3), ``Free`` (the paper's Dynamic), ``Soft``: one of
the first two, with a small deviation per frame, ``Frozen``: any of them with its shared parameters fixed, and
``MovingHand``: any of them in a hand whose pose is unknown as well.
"""

from getagrip.fitting.motion.base import (
    HandPoses,
    Motion,
    PosesInHand,
    Prior,
    hand_object_transforms,
    transform_poses,
)
from getagrip.fitting.motion.dynamic import Free, interpolate_object_poses
from getagrip.fitting.motion.frozen import Frozen
from getagrip.fitting.motion.hinge import Hinge, tangents
from getagrip.fitting.motion.moving_hand import HandPrior, MovingHand
from getagrip.fitting.motion.soft_hinge import Soft
from getagrip.fitting.motion.static import Fixed

__all__ = [
    "Fixed",
    "Free",
    "Frozen",
    "HandPoses",
    "HandPrior",
    "Hinge",
    "Motion",
    "MovingHand",
    "PosesInHand",
    "Prior",
    "Soft",
    "hand_object_transforms",
    "interpolate_object_poses",
    "tangents",
    "transform_poses",
]
