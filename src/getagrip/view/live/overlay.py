"""The image of a frame, or its masks, with the contours of what was found over it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.colors import to_rgb
from numpy import ndarray

from getagrip.geometry.camera import Crops
from getagrip.view.live.column import Column
from getagrip.view.shown import View
from getagrip.view.style import FOUND, HAND_LINE, TRUE
from getagrip.view.tiles import image_in, input_windows, intrinsics_of, silhouette_lines

SIZE = 480
"""Side of an overlay [px]."""
FRAME = 12
"""Width of frames, half of it beyond the picture [px]."""
FRACTION = 4
"""Binary digits of cv2's coordinates after the point."""


class Overlays:
    """Overlays of one column; its window follows hand and mask, and is as large in all frames."""

    def __init__(self, column: Column) -> None:
        self.column = column

    @cached_property
    def _crops(self) -> Crops:
        return input_windows([self.column.view], np.arange(len(self.column.view.result.frames)), SIZE)

    @cached_property
    def _truth(self) -> View | None:
        return self.column.truth

    def picture(self, n: int, with_truth: bool) -> UInt8[ndarray, "size size 3"]:
        """Frame ``n`` with the contours of object and hand; of the true object, too, where it is known and wanted."""
        view, mesh = self.column.view, self.column.view.clip.mesh
        K = intrinsics_of(view, n, self._crops, n)
        out = np.ascontiguousarray(image_in(view, n, self._crops, n))
        for hand in view.hands(n):
            _draw(out, silhouette_lines(*hand, K, SIZE), HAND_LINE)
        if with_truth and self._truth is not None:
            _draw(out, silhouette_lines(self._truth.object(n), mesh.faces, K, SIZE), TRUE)
        if self.column.posed:
            _draw(out, silhouette_lines(view.object(n), mesh.faces, K, SIZE), FOUND)
        return out


def _draw(picture: UInt8[ndarray, "size size 3"], lines: Sequence[Float[ndarray, "_n 2"]], colour: str) -> None:
    """Closed lines, with a halo that sets them off from any image."""
    corners = [_fixed(line) for line in lines]
    for ink, width in (((255, 255, 255), 4), (_rgb(colour), 2)):
        cv2.polylines(picture, corners, True, ink, width, cv2.LINE_AA, FRACTION)


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in to_rgb(colour))


def _fixed(line: Float[ndarray, "n 2"]) -> Int[ndarray, "n 1 2"]:
    """Pixel coordinates as cv2 counts them, from the centre of the first pixel, in fixed point."""
    return np.round((line - 0.5) * 2**FRACTION).astype(np.int32)[:, None]


def side_by_side(
    pictures: Sequence[UInt8[ndarray, "size size 3"]], colours: Sequence[str], across: int
) -> UInt8[ndarray, "H W 3"]:
    """Pictures in rows of ``across``, with white between them; several are framed in colours that tell them apart."""
    if len(pictures) > 1:
        for picture, colour in zip(pictures, colours, strict=True):
            cv2.rectangle(picture, (0, 0), (SIZE - 1, SIZE - 1), _rgb(colour), FRAME)
    blank = [np.full_like(pictures[0], 255)] * (-len(pictures) % across)
    framed = [np.pad(p, ((0, 8), (0, 8), (0, 0)), constant_values=255) for p in (*pictures, *blank)]
    rows = [np.concatenate(framed[k : k + across], axis=1) for k in range(0, len(framed), across)]
    return np.concatenate(rows)[:-8, :-8]
