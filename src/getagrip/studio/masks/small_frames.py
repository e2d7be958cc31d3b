"""Reduced frames of footage between two key frames, and arrays of each that wait in a temporary file.

The masks and the flow of all these frames are hundreds of megabytes, and each is used once more.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from numpy import dtype, ndarray

from getagrip.studio.masks.graph_cut import colour_bins
from getagrip.studio.masks.optical_flow import ZERO_STEP, Part, Step, optical_flow, translate_image

MAX_CACHED_FLOWS = 1000
"""Maximum number of pairs of frames whose flow is cached on disk, about 0.3 MB each."""


class StoredArrays(NamedTuple):
    """Places of arrays in an ``ArrayFile``."""

    place: int
    """Start of the first, in bytes; the others follow."""
    kinds: tuple[tuple[tuple[int, ...], dtype], ...]
    """Shape and type of each."""


class ArrayFile:
    """A temporary file without a name, which goes with this object."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 (closed below)
        weakref.finalize(self, self._file.close)

    def put(self, *arrays: ndarray) -> StoredArrays:
        """Write arrays at the file's end. Raises ``OSError`` where the disk is full."""
        place = self._file.seek(0, os.SEEK_END)
        for each in arrays:
            self._file.write(each.tobytes())
        return StoredArrays(place, tuple((each.shape, each.dtype) for each in arrays))

    def get(self, stored: StoredArrays) -> tuple[ndarray, ...]:
        """Read arrays back, equal in every bit; they cannot be written to."""
        self._file.seek(stored.place)
        sizes = (int(np.prod(shape)) * kind.itemsize for shape, kind in stored.kinds)
        contents = [self._file.read(size) for size in sizes]
        return tuple(
            np.ndarray(shape, kind, content) for (shape, kind), content in zip(stored.kinds, contents, strict=True)
        )


class SmallFrame(NamedTuple):
    """A reduced frame."""

    image: UInt8[ndarray, "h w 3"]
    bins: Int32[ndarray, "h w"]
    """Bins of its colours (``colour_bins``)."""
    whole: UInt8[ndarray, "H W 3"]
    """The frame at full size."""


class SmallFrames:
    """Reduced frames by number; the last three are cached, and the flow between two until it is used again."""

    def __init__(self, image: Callable[[int], UInt8[ndarray, "H W 3"]], size: tuple[int, int]) -> None:
        self.size, self.disk = size, ArrayFile()
        self._image = image
        self._frames: OrderedDict[int, SmallFrame] = OrderedDict()
        self._flows: dict[tuple[int, ...], StoredArrays] = {}

    def __getitem__(self, n: int) -> SmallFrame:
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
        """Return the flow from frame a to its neighbour b, and back, in a part of the images [px].

        ``step``: approximate displacement of the object from a to b [px]; only the rest is computed as flow.
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
                for each in self.disk.get(self._flows.pop(key))
            )
        else:
            one, other = self[min(a, b)].image[part], self[max(a, b)].image[part]
            up, down = optical_flow(one, other), optical_flow(other, one)
            if len(self._flows) < MAX_CACHED_FLOWS:
                half = (width + 1) // 2, (height + 1) // 2
                small = (cv2.resize(each, half, interpolation=cv2.INTER_AREA) for each in (up, down))
                self._flows[key] = self.disk.put(*(each.astype(np.float16) for each in small))
        return (up, down) if a < b else (down, up)
