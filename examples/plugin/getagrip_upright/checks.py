"""Two checks: of a clip before it is reconstructed, and of what was found."""

import numpy as np

from getagrip.checks import Check, Evidence
from getagrip_upright.upright import tilt


def tilt_deg(it: Evidence) -> float:
    """Median over the frames [deg]."""
    T_cam_obj = it.clip.hand.T_cam_hand @ it.T_hand_obj
    return float(np.median(np.degrees(tilt(T_cam_obj[:, :3, :3]))))


SHORT = Check(
    "short",
    lambda it: float(len(it.clip)),
    low=10,
    serious=False,
    fault="the clip has {value} frames",
    advice="tell an axis from as few if you must",
)
TILTED = Check(
    "tilted",
    tilt_deg,
    high=45.0,
    serious=False,
    fault="the object is tilted by {value} degrees",
    advice="does it stand upright at all?",
)
