"""The size of a hand that was lifted from 2D, where the object's own is known: it follows from the object's.

Such a hand has an assumed size, and its distance follows from that: a mug of known size would be elsewhere than the
hand that holds it. To one camera a scene that is twice as large and twice as far away is the same. So the object's size
is free beside the hand's in the fit, and what is found is scaled until the object has its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.fitting.options import Options
from getagrip.provenance import assumed, is_assumed
from getagrip.result import Reconstruction

SPREAD = 0.1
"""Standard deviation of the logarithm of a lifted hand's size. Assumed; 0.1 to 0.6 do alike (docs/trials.md)."""
FOLLOWS = assumed("it follows from the object's, which is known")


def beside_hand(clip: Clip, options: Options) -> Clip:
    """Return the clip with the object's size free where the hand's follows from it; else the clip as it is.

    Segments of timelines are solved without a hand, too, at the object's own size.
    """
    follows = clip.scale == "known" and is_assumed(clip.provenance.get("hands_scale"))
    if not follows or clip.segments or options.as_published:
        return clip
    return replace(clip, scale="free", size_beside_hand=True, provenance=clip.provenance | {"hands_scale": FOLLOWS})


def at_object_size(result: Reconstruction, clip: Clip) -> Reconstruction:
    """Scale the result of a clip ``beside_hand`` about the camera until the object has its own size."""
    if not clip.size_beside_hand:
        return result
    size, T_cam_hand = 1.0 / result.scale, result.T_cam_hand
    if T_cam_hand is None:
        T_cam_hand = clip.hand.T_cam_hand[clip.index_of(result.frames)]
    axis, found, covariance = result.axis, result.candidates, result.hand_covariance
    units = np.array([size, size, size, 1.0, 1.0, 1.0])
    return replace(
        result,
        scale=1.0,
        T_hand_obj=_scaled(result.T_hand_obj, size),
        axis=None if axis is None else replace(axis, point=size * axis.point),
        candidates=replace(found, T_hand_obj=_scaled(found.T_hand_obj, size), scale=size * found.scale),
        T_cam_hand=_scaled(T_cam_hand, size),
        hand_scale=size,
        hand_covariance=None if covariance is None else covariance * np.outer(units, units),
        hand_alternatives=None if result.hand_alternatives is None else _scaled(result.hand_alternatives, size),
    )


def _scaled(T: Float[ndarray, "*batch 4 4"], size: float) -> Float[ndarray, "*batch 4 4"]:
    """Return poses whose places are scaled."""
    out = T.copy()
    out[..., :3, 3] *= size
    return out
