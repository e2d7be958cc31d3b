"""The camera of a user's own images, as far as the user knows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.camera_of_image import WIDE, field_of_view, in_pixels
from getagrip.clip.plausible import check_intrinsics
from getagrip.errors import InputError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.provenance import Source, assumed, measured


def intrinsics(lens: Lens, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Source]:
    """The pinhole of images of some size [px], and where it comes from. Raises ``UsageError``."""
    given = [lens.K is not None, lens.focal is not None, lens.guess_focal]
    if not any(given):
        raise UsageError("missing --K, --focal or --guess-focal: the camera")
    if sum(given) > 1:
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
            source = assumed(
                "a guess: the focal length is the longer side of the image, the principal point in the middle"
            )
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if lens.focal is not None and lens.focal > 0.0 and field_of_view(K[None], size) > WIDE:
        raise UsageError(f"--focal must be in pixels (got {lens.focal:g}); {in_pixels(lens.focal, size)}")
    try:
        check_intrinsics(Path(), K[None], size)
    except InputError as error:
        option = "--K" if lens.K is not None else "--focal"
        raise UsageError(f"{option} must be {error.expected} (got {error.given})") from error
    return K, source
