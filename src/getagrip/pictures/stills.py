"""Frames as plain pictures, for films and pages: over the image, and turned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.geometry.camera import Crops
from getagrip.pictures.shown import View
from getagrip.pictures.style import AXIS, FOUND, HAND_LINE, HIDDEN
from getagrip.pictures.tiles import image_in, input_windows, intrinsics_of, posed, silhouette_lines

STEADY = 0.35
"""Windows move as smoothly as a mean over this time [s]."""
ROOM = 1.12
"""Factor by which they are larger than those of single frames, since they lag behind."""
SUBPIXEL = 3
"""Bits after the point of coordinates that OpenCV draws at."""


def steady_windows(view: View, size: int) -> Crops:
    """Return a square window around hand and masks in each frame, of one size, that moves smoothly."""
    crops = input_windows([view], np.arange(len(view.result.frames)), size)
    middle = crops.corner + crops.side / 2.0
    smooth = smoothed(middle, STEADY * view.clip.fps)
    side = max(ROOM * crops.side, float(crops.side + 2.0 * np.abs(smooth - middle).max()))
    return replace(crops, corner=smooth - side / 2.0, side=side)


def smoothed(track: Float[ndarray, "T k"], over: float) -> Float[ndarray, "T k"]:
    """Smooth a track by a Gaussian of ``over`` frames; its ends are repeated beyond it."""
    reach = int(4.0 * over + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / over) ** 2)
    padded = np.pad(track, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weight / weight.sum(), mode="valid") for column in padded.T], axis=1)


def overlay(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw frame ``n`` in window ``k``, with the contours of hand and object."""
    picture, K = image_in(view, n, crops, k), intrinsics_of(view, n, crops, k)
    for hand in view.hands(n):
        _draw(picture, silhouette_lines(*hand, K, crops.size), HAND_LINE, crops.size / 400.0)
    found = silhouette_lines(view.object(n), view.clip.mesh.faces, K, crops.size)
    _draw(picture, found, FOUND, max(1.5, crops.size / 320.0))
    return picture


def turned(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw hand, object and axis of frame ``n``, from the side."""
    picture, line = posed(view, n, crops, k, from_side=True)
    if line is not None:
        uv, visible = line
        _draw(picture, _stretches(uv, ~visible), HIDDEN, crops.size / 480.0, closed=False, halo=False)
        _draw(picture, _stretches(uv, visible), AXIS, crops.size / 320.0, closed=False)
    return picture


def _stretches(uv: Float[ndarray, "n 2"], chosen: Bool[ndarray, "n"]) -> list[Float[ndarray, "_n 2"]]:
    """Return the chosen points of a line, where they follow one another."""
    ends = np.flatnonzero(np.diff(chosen.astype(int))) + 1
    return [
        part for part, first in zip(np.split(uv, ends), np.split(chosen, ends), strict=True) if len(part) and first[0]
    ]


def _draw(
    picture: UInt8[ndarray, "H W 3"],
    lines: Iterable[Float[ndarray, "_n 2"]],
    colour: str,
    width: float,
    closed: bool = True,
    halo: bool = True,
) -> None:
    """Lines of a colour ``#rrggbb``, on a white halo if wanted."""
    rgb = tuple(bytes.fromhex(colour[1:]))
    # OpenCV counts from the centre of the first pixel
    points = [np.round((line - 0.5) * 2**SUBPIXEL).astype(np.int32)[:, None] for line in lines]
    for drawn, thick in (((255, 255, 255), 2.8 * width), (rgb, 1.3 * width))[not halo :]:
        cv2.polylines(picture, points, closed, drawn, max(1, round(thick)), cv2.LINE_AA, SUBPIXEL)
