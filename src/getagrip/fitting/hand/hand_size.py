"""The size of a hand that was lifted from 2D, from a sensor's depth or from the object's known size.

A lifted hand has an assumed size, and its distance follows from the size: a mug of known size would be apart from the
hand that holds it. To one camera a scene twice as large and twice as far away is the same. So the hand is scaled about
the camera to the distance that a sensor's depth shows. Without depth the object's size is free beside the hand's in the
fit, and the result is scaled until the object has its known size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, read_masks
from getagrip.clip.depth import DEPTH_KEY, MAX_DEPTH_RATIO, Depth
from getagrip.fitting.energy.depth_term import median_hand_depth_ratio, sample_depth
from getagrip.fitting.options import Options
from getagrip.fitting.problem import sample_clip_frames
from getagrip.provenance import assumed, estimated, is_assumed
from getagrip.result import Reconstruction

HAND_SIZE_SIGMA = 0.1
"""Standard deviation of the logarithm of a lifted hand's size. Assumed; 0.1 to 0.6 do alike (docs/trials.md)."""
HAND_SIZE_FROM_OBJECT = assumed("it follows from the object's, which is known")
HAND_SIZE_FROM_DEPTH = estimated("from the distance at which a sensor's depth shows the hand")
N_HAND_SIZE_FRAMES, MAX_HAND_SIZE_SAMPLES, MIN_HAND_SIZE_SAMPLES = 12, 100, 20
"""Number of frames whose depth is read; maximum number of the hand's samples in each; minimum number in all frames."""


def with_hand_size(clip: Clip, options: Options) -> Clip:
    """Return the clip with a lifted hand at the distance of a sensor's depth, or else the object's size free.

    A clip without a sensor's depth whose object's size is unknown stays unchanged. So do timelines, some of whose
    segments are solved without a hand.
    """
    if not is_assumed(clip.provenance.get("hands_scale")) or clip.segments or options.as_published:
        return clip
    size = hand_size_from_depth(clip)
    if not np.isnan(size):
        hand = replace(clip.hand.scaled(size), T_cam_hand=_scale_translations(clip.hand.T_cam_hand, size))
        provenance = clip.provenance | {"hands_scale": HAND_SIZE_FROM_DEPTH}
        return replace(clip, hand=hand, hand_scale=size, provenance=provenance)
    if clip.scale != "known":
        return clip
    provenance = clip.provenance | {"hands_scale": HAND_SIZE_FROM_OBJECT}
    return replace(clip, scale="free", size_beside_hand=True, provenance=provenance)


def hand_size_from_depth(clip: Clip) -> float:
    """Return the ratio of the hand's distance in a sensor's depth to its input distance; NaN where unknown.

    Raises ``InputError`` for masks and depth that cannot be read.
    """
    if not clip.evidence.get(DEPTH_KEY, clip.folder is not None and (clip.folder / DEPTH_KEY).exists()):
        return np.nan
    few = sample_clip_frames(clip, N_HAND_SIZE_FRAMES)
    depth = few.evidence.get(DEPTH_KEY)
    if not isinstance(depth, Depth) or (depth.source.scale, depth.source.source) != ("metric", "sensor"):
        return np.nan
    samples = sample_depth(few, read_masks(few), depth, MAX_HAND_SIZE_SAMPLES)
    size, on_hand = median_hand_depth_ratio(samples), np.sum(samples.used - samples.on_object)
    return size if on_hand >= MIN_HAND_SIZE_SAMPLES and abs(np.log(size)) < np.log(MAX_DEPTH_RATIO) else np.nan


def restore_object_size(result: Reconstruction, clip: Clip) -> Reconstruction:
    """Scale the result of a clip ``with_hand_size`` about the camera until the object has its known size.

    The result of a clip whose size was not changed stays unchanged.
    """
    size = 1.0 / result.scale if clip.size_beside_hand else 1.0
    if size * clip.hand_scale == 1.0:
        return result
    assert result.T_cam_hand is not None
    axis, found, covariance = result.axis, result.candidates, result.hand_covariance
    others = result.hand_alternatives
    units = np.array([size, size, size, 1.0, 1.0, 1.0])
    return replace(
        result,
        scale=1.0 if clip.size_beside_hand else result.scale,
        T_hand_obj=_scale_translations(result.T_hand_obj, size),
        axis=None if axis is None else replace(axis, point=size * axis.point),
        candidates=replace(found, T_hand_obj=_scale_translations(found.T_hand_obj, size), scale=size * found.scale),
        T_cam_hand=_scale_translations(result.T_cam_hand, size),
        hand_scale=size * clip.hand_scale,
        hand_covariance=None if covariance is None else covariance * np.outer(units, units),
        hand_alternatives=None if others is None else _scale_translations(others, size),
    )


def _scale_translations(T: Float[ndarray, "*batch 4 4"], size: float) -> Float[ndarray, "*batch 4 4"]:
    out = T.copy()
    out[..., :3, 3] *= size
    return out
