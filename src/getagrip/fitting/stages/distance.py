"""The object's distance from the camera, as an interval: one view shows it by sizes, which are uncertain by percents.

Two measures of the distance are independent: the hand's size and the object's. Each has a relative error, its size's
and that of the fit; a sensor's depth is a third one. Together they err by s,

    1 / s^2 = sum of 1 / (size_i^2 + FIT_DISTANCE_SIGMA^2),

and the interval is the result's distance times exp(-c s) to exp(c s), with c such that it contains the true distances
of nine of ten rendered training videos.
"""

from __future__ import annotations

import numpy as np

from getagrip.clip import Clip
from getagrip.fitting.hand.joint_hand_object import (
    HAND_DEPTH_SIGMAS_M,
    HAND_SIZE_SIGMA,
    STATED_SIZE_SIGMA,
    sample_sensor_depth,
)
from getagrip.fitting.solver.category_prior import unmeasured_kind
from getagrip.geometry import se3
from getagrip.provenance import is_assumed, kind_of_hands
from getagrip.result import Reconstruction

FIT_DISTANCE_SIGMA = 0.02
"""Standard deviation of the logarithm of a distance that a fit finds by exact sizes."""
MEASURED_HAND_SIGMA_M = 0.005
"""Standard deviation of the distance of a measured hand [m]."""
DISTANCE_INTERVAL_SIGMAS = 2.5
"""Half of the interval's width in the combined standard deviation: that of 12 of 13 drafts of rendered training videos.
Normal errors would need 1.645; hands that are taken for others, or for the other way round, have heavier tails."""


def distance_interval(clip: Clip, result: Reconstruction) -> tuple[float, float] | None:
    """Return the interval with 90 % of the object's distance from the camera, median over frames [mm].

    ``clip`` is as the fit had it (``with_hand_size``). None where the result has no hand poses.
    """
    if result.T_cam_hand is None:
        return None
    T = result.T_cam_hand @ result.T_hand_obj
    centre = result.scale * clip.warped(result.warp).mesh.centre
    distance = float(np.median(np.linalg.norm(se3.transform(T, centre[None])[:, 0], axis=1)))
    spread = distance_spread(clip, distance)
    low, high = 1e3 * distance * np.exp(DISTANCE_INTERVAL_SIGMAS * spread * np.array([-1.0, 1.0]))
    return float(low), float(high)


def distance_spread(clip: Clip, distance: float) -> float:
    """Return the standard deviation of the logarithm of a distance from the camera [m], by sizes and by depth."""
    errors = np.array([_hand_sigma(clip, distance), _object_sigma(clip), _sensor_sigma(clip)])
    return float(np.sum(1.0 / (errors**2 + FIT_DISTANCE_SIGMA**2))) ** -0.5


def _hand_sigma(clip: Clip, distance: float) -> float:
    """Return the relative standard deviation of the hand's distance [m]."""
    if is_assumed(clip.provenance.get("hands_scale")):
        return HAND_SIZE_SIGMA
    estimated = kind_of_hands(clip.provenance) == "estimated"
    return (HAND_DEPTH_SIGMAS_M[0] if estimated else MEASURED_HAND_SIGMA_M) / distance


def _object_sigma(clip: Clip) -> float:
    """Return the standard deviation of the logarithm of the object's size; infinite where nothing is known of it."""
    if clip.scale == "known" or clip.size_sigmas is not None:
        return STATED_SIZE_SIGMA if is_assumed(clip.provenance.get("mesh")) else 0.0
    kind = unmeasured_kind(clip)
    return np.inf if kind is None else kind.spread


def _sensor_sigma(clip: Clip) -> float:
    """Return the relative standard deviation of a sensor's depth; infinite without it."""
    depth = sample_sensor_depth(clip, 1)[1]
    return np.inf if depth is None else depth.source.assumed_error
