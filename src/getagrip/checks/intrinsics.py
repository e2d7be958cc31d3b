"""Intrinsics of a user's own images, from the options of ``Lens``, and warnings about implausible ones.

Calibrations are often made at another size, crop or orientation than the images'. A principal point far from the
middle, non-square pixels and an extreme field of view are possible, so that they cause warnings, not errors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.read_arrays import check_intrinsics
from getagrip.errors import InputError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.provenance import Source, assumed, measured

MAX_PRINCIPAL_POINT_OFFSET = 0.1
"""Maximum plausible distance of the principal point from the middle, as a fraction of the image's sides."""
MAX_FOCAL_RATIO = 1.1
"""Maximum plausible ratio of the two focal lengths."""
MIN_FOV_DEG, MAX_FOV_DEG = 6.0, 118.0
"""Plausible fields of view along the longer side [degrees]."""
FILM_WIDTH_MM = 36.0
"""Width of 35-mm film, to which equivalent focal lengths refer [mm]."""


def compute_intrinsics(lens: Lens, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Source]:
    """Compute the intrinsics of images of some size [px]; also return their source. Raises ``UsageError``."""
    got = [lens.K is not None, lens.focal is not None, lens.guess_focal]
    if not any(got):
        raise UsageError("missing --K, --focal or --guess-focal: the camera")
    if sum(got) > 1:
        raise UsageError("--K, --focal, --guess-focal cannot be used with each other")
    width, height = size
    if lens.K is not None:
        fx, fy, cx, cy = lens.K
        source = measured("given as fx, fy, cx, cy")
    else:
        fx = fy = float(max(size)) if lens.focal is None else lens.focal
        cx, cy = width / 2.0, height / 2.0
        source = measured("the focal length as given, the principal point in the middle")
        if lens.focal is None:
            middle = "the principal point in the middle"
            source = assumed(f"a guess: the focal length is the longer side of the image, {middle}")
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if lens.focal is not None and lens.focal > 0.0 and field_of_view(K[None], size) > MAX_FOV_DEG:
        raise UsageError(f"--focal must be in pixels (got {lens.focal:g}); {focal_advice(lens.focal, size)}")
    try:
        check_intrinsics(Path(), K[None], size)
    except InputError as error:
        option = "--K" if lens.K is not None else "--focal"
        raise UsageError(f"{option} must be {error.expected} (got {error.got})") from error
    return K, source


def principal_point_offset(K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> float:
    """Measure the worst frame's distance of the principal point from the middle, as a fraction of the image's sides."""
    return float(np.abs(K[:, :2, 2] / size - 0.5).max())


def focal_ratio(K: Float[ndarray, "T 3 3"]) -> float:
    """Return the worst frame's ratio of the two focal lengths."""
    ratio = K[:, 0, 0] / K[:, 1, 1]
    return float(np.maximum(ratio, 1.0 / ratio).max())


def field_of_view(K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> float:
    """Measure the field of view along the longer side of the image [degrees], in the least plausible frame."""
    longer = int(np.argmax(size))
    angles = np.degrees(2.0 * np.arctan(0.5 * size[longer] / K[:, longer, longer]))
    return float(angles[np.argmax(np.abs(angles - 0.5 * (MIN_FOV_DEG + MAX_FOV_DEG)))])


def camera_warning(K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> str:
    """Say why intrinsics seem to belong to images of another size [px]; empty if they are plausible."""
    image = f"the {size[0]} x {size[1]} images"
    if principal_point_offset(K, size) > MAX_PRINCIPAL_POINT_OFFSET:
        u, v = K[int(np.argmax(np.abs(K[:, :2, 2] / size - 0.5).max(axis=1))), :2, 2]
        fits = f"it fits images of {2 * u:.0f} x {2 * v:.0f}" if min(u, v) > 0 else "it fits no whole image"
        return f"the principal point {u:.4g}, {v:.4g} is far from the middle of {image}: {fits}"
    if focal_ratio(K) > MAX_FOCAL_RATIO:
        ratio = K[:, 0, 0] / K[:, 1, 1]
        fx, fy = K[int(np.argmax(np.maximum(ratio, 1.0 / ratio))), [0, 1], [0, 1]]
        fits = f"{size[0] * fy / fx:.0f} x {size[1]} or {size[0]} x {size[1] * fx / fy:.0f}"
        return f"fx {fx:.4g} and fy {fy:.4g} are of pixels that are not square: K fits images of {fits}"
    angle = field_of_view(K, size)
    if not MIN_FOV_DEG <= angle <= MAX_FOV_DEG:
        return f"the field of view of {image} would be {angle:.3g} degrees: {focal_advice(K[0, 0, 0], size)}"
    return ""


def focal_advice(focal: float, size: tuple[int, int]) -> str:
    """Give advice on a focal length too short or too long for images of a size [px]."""
    if focal > max(size):
        return "the focal length is of larger images, or an estimator's own and not the camera's"
    pixels = focal / FILM_WIDTH_MM * max(size)
    return (
        f"is {focal:.4g} in mm? The 35-mm equivalent f of a lens is f / {FILM_WIDTH_MM:g} * {max(size)} px: "
        f"{pixels:.0f} px for {focal:.4g} mm"
    )
