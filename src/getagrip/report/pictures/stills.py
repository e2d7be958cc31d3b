"""Single frames as pictures, for films and pages: over the image, and from the side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.geometry.camera import Crops
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_LINE_COLOUR,
    HIDDEN_AXIS_COLOUR,
    RESULT_COLOUR,
    crop_image,
    input_windows,
    render_posed,
    silhouette_lines,
    window_intrinsics,
)
from getagrip.report.pictures.result_view import View

WINDOW_SMOOTHING_S = 0.35
"""Standard deviation in time of the smoothing of windows [s]."""
WINDOW_MARGIN_FACTOR = 1.12
"""Size of smoothed windows, which lag behind, relative to windows of single frames."""
SUBPIXEL_BITS = 3
"""Fractional bits of the coordinates that OpenCV draws at."""


def smooth_windows(view: View, size: int) -> Crops:
    """Return square windows of one size around hand and masks, one a frame, that move smoothly."""
    crops = input_windows([view], np.arange(len(view.result.frames)), size)
    middle = crops.corner + crops.side / 2.0
    smooth = smooth_track(middle, WINDOW_SMOOTHING_S * view.clip.fps)
    side = max(WINDOW_MARGIN_FACTOR * crops.side, float(crops.side + 2.0 * np.abs(smooth - middle).max()))
    return replace(crops, corner=smooth - side / 2.0, side=side)


def smooth_track(track: Float[ndarray, "T k"], over: float) -> Float[ndarray, "T k"]:
    """Smooth a track by a Gaussian with a standard deviation of ``over`` frames; ends are repeated."""
    reach = int(4.0 * over + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / over) ** 2)
    padded = np.pad(track, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weight / weight.sum(), mode="valid") for column in padded.T], axis=1)


def draw_overlay(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw frame ``n`` in window ``k``, with the contours of hand and object."""
    picture, K = crop_image(view, n, crops, k), window_intrinsics(view, n, crops, k)
    for hand in view.hands(n):
        _draw_polylines(picture, silhouette_lines(*hand, K, crops.size), HAND_LINE_COLOUR, crops.size / 400.0)
    found = silhouette_lines(view.object(n), view.clip.mesh.faces, K, crops.size)
    _draw_polylines(picture, found, RESULT_COLOUR, max(1.5, crops.size / 320.0))
    return picture


def draw_side_view(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw hand, object and axis of frame ``n``, from the side."""
    picture, line = render_posed(view, n, crops, k, from_side=True)
    if line is not None:
        uv, visible = line
        hidden = _contiguous_parts(uv, ~visible)
        _draw_polylines(picture, hidden, HIDDEN_AXIS_COLOUR, crops.size / 480.0, closed=False, halo=False)
        _draw_polylines(picture, _contiguous_parts(uv, visible), AXIS_COLOUR, crops.size / 320.0, closed=False)
    return picture


def _contiguous_parts(uv: Float[ndarray, "n 2"], chosen: Bool[ndarray, "n"]) -> list[Float[ndarray, "_n 2"]]:
    """Split a line into its runs of chosen points."""
    ends = np.flatnonzero(np.diff(chosen.astype(int))) + 1
    parts = zip(np.split(uv, ends), np.split(chosen, ends), strict=True)
    return [part for part, is_chosen in parts if len(part) and is_chosen[0]]


def _draw_polylines(
    picture: UInt8[ndarray, "H W 3"],
    lines: Iterable[Float[ndarray, "_n 2"]],
    colour: str,
    width: float,
    closed: bool = True,
    halo: bool = True,
) -> None:
    rgb = tuple(bytes.fromhex(colour[1:]))
    # OpenCV's origin is the centre of the first pixel
    points = [np.round((line - 0.5) * 2**SUBPIXEL_BITS).astype(np.int32)[:, None] for line in lines]
    for drawn, thick in (((255, 255, 255), 2.8 * width), (rgb, 1.3 * width))[not halo :]:
        cv2.polylines(picture, points, closed, drawn, max(1, round(thick)), cv2.LINE_AA, SUBPIXEL_BITS)
