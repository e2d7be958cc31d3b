"""Motion models: how an object may move in a hand, a file each.

``Fixed`` (the paper's Static), ``Hinge`` (the paper's 1-DoF, Eq. 3), ``Free`` (the paper's Dynamic), and ``Soft``: one
of the first two, with a small deviation per frame.
"""

from getagrip.fitting.motion.base import Motion, PosesInHand, Prior
from getagrip.fitting.motion.fixed import Fixed
from getagrip.fitting.motion.free import Free
from getagrip.fitting.motion.hinge import Hinge, tangents
from getagrip.fitting.motion.soft import Soft

__all__ = ["Fixed", "Free", "Hinge", "Motion", "PosesInHand", "Prior", "Soft", "tangents"]
