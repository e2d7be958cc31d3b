"""Optical flow between frames, and the origins of pixels in the frame before: each its own, or those of one object.

Dense inverse search (Kroeger, Timofte, Dai, Van Gool, "Fast Optical Flow using Dense Inverse Search", ECCV 2016)
computes the flow, in both directions of time at once. Frames are reduced to the size at which masks are propagated;
lengths are in pixels of this size.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

Image = UInt8[ndarray, "H W 3"]
Origins = tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]]
"""x and y of each pixel's place in the frame before [px]."""

MAX_MOTION_SAMPLES = 2000
"""Maximum number of the object's pixels that its motion is fitted to; a hundredth of this number is the minimum."""
FLOW_BLUR_SIGMA_PX = 10.0
"""Standard deviation of the Gaussian that averages the flow of the object's pixels [px]."""
FLOW_SIGMA_PX = 1.5
"""Standard deviation of flow [px]."""
MAX_MOTION_LOG_RATIO = 3.0
"""Largest logarithm of the ratio of the probabilities of two motions."""
SHOT_CHANGE_THRESHOLD = 10.0
"""Median difference of pixels from their origins above which the video is cut [of 255]."""


def fit_object_motion(
    x: Float32[ndarray, "h w"], y: Float32[ndarray, "h w"], came: Origins, inner: Bool[ndarray, "h w"]
) -> Origins | None:
    """Return the origins of all pixels if they moved like the nearby ``inner`` pixels of the object.

    Near a border flow mixes both sides, so masks moved by it would lag. None with too few ``inner`` pixels.
    """
    import cv2

    some = np.flatnonzero(inner)[:: max(1, np.count_nonzero(inner) // MAX_MOTION_SAMPLES)]
    if len(some) < MAX_MOTION_SAMPLES // 100:
        return None
    here, there = (np.stack([each.ravel()[some] for each in pair], axis=1) for pair in ((x, y), came))
    A = cv2.estimateAffine2D(here, there, method=cv2.RANSAC, ransacReprojThreshold=1.0)[0]
    if A is None:
        return None
    weight = inner.astype(np.float32)
    affine = [(row[0] * x + row[1] * y + row[2]).astype(np.float32) for row in A]
    shifts = [weight * np.clip(each - one, -3.0, 3.0) for each, one in zip(came, affine, strict=True)]
    total, *sums = (_blur_flow(each) for each in (weight, *shifts))
    return affine[0] + sums[0] / (total + 0.01), affine[1] + sums[1] / (total + 0.01)


def _blur_flow(values: Float32[ndarray, "h w"]) -> Float32[ndarray, "h w"]:
    """Blur by ``FLOW_BLUR_SIGMA_PX``, at a quarter of the size for speed."""
    import cv2

    size = values.shape[::-1]
    small = cv2.resize(values, tuple(max(1, n // 4) for n in size), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(cv2.GaussianBlur(small, (0, 0), FLOW_BLUR_SIGMA_PX / 4.0), size), np.float32)


def motion_log_ratio(
    came: Origins, own: Origins, ground: Origins | None, off: Float32[ndarray, "h w"]
) -> Float32[ndarray, "h w"]:
    """Return the log ratio of the probabilities that a pixel moves with the object or with its surroundings.

    ``came`` are the origins by flow, with an error of ``off`` [px]; ``own`` and ``ground`` those of object and ground.
    """
    import cv2

    if ground is None:
        return np.zeros_like(off)
    apart = [(came[0] - each[0]) ** 2 + (came[1] - each[1]) ** 2 for each in (ground, own)]
    ratio = (apart[0] - apart[1]) / (2.0 * (FLOW_SIGMA_PX**2 + off**2))
    limited = np.clip(ratio, -MAX_MOTION_LOG_RATIO, MAX_MOTION_LOG_RATIO)
    return np.asarray(cv2.GaussianBlur(limited, (0, 0), 2.0), np.float32)


def hand_displacement(before: Bool[ndarray, "h w"] | None, after: Bool[ndarray, "h w"] | None) -> tuple[int, int]:
    """Measure a hand's displacement from one frame to the next [px]; 0 if either mask is missing or empty."""
    if before is None or after is None or not before.any() or not after.any():
        return 0, 0
    y, x = (float(np.median(np.nonzero(after)[n]) - np.median(np.nonzero(before)[n])) for n in (0, 1))
    return round(x), round(y)


def is_other_shot(before: Image, after: Image, came: Origins) -> bool:
    """Return whether the video is cut between two images: most pixels differ from their origins ``came``."""
    import cv2

    expected = cv2.remap(before, *came, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    apart = cv2.absdiff(np.asarray(expected)[::2, ::2], after[::2, ::2])
    return bool(np.median(np.sum(cv2.split(apart), axis=0, dtype=np.float32)) > 3.0 * SHOT_CHANGE_THRESHOLD)


def warp_values(
    values: Float32[ndarray, "h w"], old: tuple[Float32[ndarray, "H W"], Float32[ndarray, "H W"]], outside: float
) -> Float32[ndarray, "H W"]:
    """Sample values at the origins ``old`` of pixels; ``outside`` is the value beyond them."""
    import cv2

    return np.asarray(cv2.remap(values, *old, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, outside), np.float32)


def optical_flow(a: Image, b: Image) -> Float32[ndarray, "H W 2"]:
    """Return the flow from a to b: each pixel's place in b minus its place in a [px]."""
    import cv2

    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    a, b = (cv2.cvtColor(np.ascontiguousarray(each), cv2.COLOR_RGB2GRAY) for each in (a, b))
    return np.asarray(search.calc(a, b, np.zeros((*a.shape, 2), np.float32)), np.float32)


def squared_flow_error(
    there: Float32[ndarray, "h w 2"], back: Float32[ndarray, "h w 2"], came: Origins
) -> Float32[ndarray, "h w"]:
    """Return the squared distance of pixels from their start after flow ``back`` to origins and ``there`` [px^2]."""
    import cv2

    error = back + cv2.remap(there, *came, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(np.einsum("hwc,hwc->hw", error, error))


Part = tuple[slice, slice]
"""Rows and columns."""
Step = tuple[int, int]
"""Steps along x and y [px]."""
ZERO_STEP: Step = (0, 0)


def translate_image(image: ndarray, step: Step) -> ndarray:
    """Translate an image by whole pixels; its border is repeated."""
    import cv2

    M = np.array([[1.0, 0.0, step[0]], [0.0, 1.0, step[1]]])
    return cv2.warpAffine(image, M, image.shape[1::-1], flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
