"""From a square crop's camera to the whole image's: where a network's hand is before a real camera.

A network that is given a crop of side b [px] about (cx, cy) predicts (s, tx, ty): a point X of its hand projects to

    (u, v) = (cx, cy) + (b s / 2) (X + tx, Y + ty):

``b s / 2`` pixels to the metre, its origin at ``(cx, cy) + (b s / 2) (tx, ty)``. A pinhole of focal length f sees as
many pixels to the metre at the depth z = f / (b s / 2), which is what HaMeR's ``cam_crop_to_full`` computes (the
notation is SPIN's and CLIFF's). Whatever focal length an estimator has assumed, its pixels to the metre and the place
of its origin in the image are what it observed; depth follows from them and the real focal length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.hands.trackers.estimates import Camera

HAMER_FOCAL, HAMER_CROP = 5000.0, 256.0
"""HaMeR's and WiLoR's demos assume a focal length of 5000 / 256 times the larger side of the image [px]."""


class WeakPerspective(NamedTuple):
    """An orthographic camera in an image."""

    origin: Float[ndarray, "2"]
    """Projection (u, v) of the hand's origin [px]."""
    pixels_per_metre: float

    @staticmethod
    def of_crop(centre: Float[ndarray, "2"], side: float, cam: Float[ndarray, "3"]) -> WeakPerspective:
        """Make it from a crop's middle and side [px], and the camera (s, tx, ty) in it."""
        scale = side * cam[0] / 2.0
        return WeakPerspective(centre + scale * cam[1:], float(scale))

    @staticmethod
    def of_translation(t: Float[ndarray, "3"], focal: float, centre: Float[ndarray, "2"]) -> WeakPerspective:
        """Make it from a translation [m] before a pinhole with a focal length and a principal point [px]."""
        return WeakPerspective(centre + focal * t[:2] / t[2], focal / float(t[2]))

    def resized(self, zoom: Float[ndarray, "2"]) -> WeakPerspective:
        """Return it in an image ``zoom`` times as wide and as high."""
        return WeakPerspective(self.origin * zoom, self.pixels_per_metre * float(zoom[0]))

    def before(self, camera: Camera) -> Float[ndarray, "3"]:
        """Return the translation [m] that shows the hand's origin there, and at fx / z pixels to the metre."""
        K = camera.K
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a hand that is too far is refused later
            z = K[0, 0] / self.pixels_per_metre
            return np.array([*(z * (self.origin - K[:2, 2]) / K[[0, 1], [0, 1]]), z])


def hamer_focal(size: tuple[int, int]) -> float:
    """Return the focal length that HaMeR's and WiLoR's demos assume of an image [px]."""
    return HAMER_FOCAL / HAMER_CROP * max(size)


def vitdet_side(box: Float[ndarray, "2"], rescale: float) -> float:
    """Return the side [px] of the crop that HaMeR takes of a box of some width and height.

    ``rescale`` times as large, and high enough for 192 : 256 (``expand_to_aspect_ratio``).
    """
    width, height = rescale * box
    return float(max(height, width * 256.0 / 192.0))
