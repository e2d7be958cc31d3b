"""Frames at the size at which masks are carried, and the flow between neighbours, for both directions of time at once.

Dense inverse search (``object_motion.flow``) computes flow at half the size; at this size it is kept.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float16, Float32, Int32, UInt8
from numpy import ndarray

from getagrip.annotate.colour_cut import colour_bins
from getagrip.annotate.object_motion import optical_flow

Part = tuple[slice, slice]
"""Rows and columns."""
Step = tuple[int, int]
"""Steps along x and y [px]."""
ZERO_STEP: Step = (0, 0)
MAX_CACHED_FLOWS = 1000
"""Pairs of frames of which flow is kept, about 0.3 MB each."""


class SmallFrame(NamedTuple):
    """A frame on its way through the propagation."""

    image: UInt8[ndarray, "h w 3"]
    bins: Int32[ndarray, "h w"]
    """Bins of its colours."""
    whole: UInt8[ndarray, "H W 3"]
    """The frame at its own size."""


class SmallFrames:
    """Frames by number, made smaller; the last few are kept, as is the flow between two until it is used again."""

    def __init__(self, image: Callable[[int], UInt8[ndarray, "H W 3"]], size: tuple[int, int]) -> None:
        self.size = size
        self._image = image
        self._frames: OrderedDict[int, SmallFrame] = OrderedDict()
        self._flows: dict[tuple[int, ...], tuple[Float16[ndarray, "h w 2"], ...]] = {}

    def __getitem__(self, n: int) -> SmallFrame:
        """Return a frame."""
        import cv2

        if n not in self._frames:
            whole = self._image(n)
            image = np.asarray(cv2.resize(whole, self.size, interpolation=cv2.INTER_AREA), np.uint8)
            self._frames[n] = SmallFrame(image, colour_bins(image), whole)
            if len(self._frames) > 3:
                self._frames.popitem(last=False)
        return self._frames[n]

    def flows(
        self, a: int, b: int, part: Part, step: Step = ZERO_STEP
    ) -> tuple[Float32[ndarray, "h w 2"], Float32[ndarray, "h w 2"]]:
        """Return flow from frame a to its neighbour b, and back, in a part of them [px].

        ``step``: how far what matters has moved from a to b, about [px]; flow finds what is left.
        """
        import cv2

        if step != ZERO_STEP:
            one, other = translate_image(self[a].image[part], step), self[b].image[part]
            there, back = translate_image(optical_flow(one, other), (-step[0], -step[1])), optical_flow(other, one)
            return there + np.array(step, np.float32), back - np.array(step, np.float32)
        key = (min(a, b), *(end for each in part for end in (each.start, each.stop)))
        height, width = (each.stop - each.start for each in part)
        if key in self._flows:
            up, down = (
                cv2.resize(each.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
                for each in self._flows.pop(key)
            )
        else:
            one, other = self[min(a, b)].image[part], self[max(a, b)].image[part]
            up, down = optical_flow(one, other), optical_flow(other, one)
            if len(self._flows) < MAX_CACHED_FLOWS:
                half = (width + 1) // 2, (height + 1) // 2
                small = (cv2.resize(each, half, interpolation=cv2.INTER_AREA) for each in (up, down))
                self._flows[key] = tuple(each.astype(np.float16) for each in small)
        return (up, down) if a < b else (down, up)


def translate_image(image: ndarray, step: Step) -> ndarray:
    """Return an image whose content is moved by whole pixels, its border repeated."""
    import cv2

    M = np.array([[1.0, 0.0, step[0]], [0.0, 1.0, step[1]]])
    return cv2.warpAffine(image, M, image.shape[1::-1], flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
