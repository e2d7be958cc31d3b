"""The label maps of frames that were filled in, kept in memory for files of the same labels."""

from __future__ import annotations

import zlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.studio.masks.propagate_clip import PropagatedLabels, propagate_labels
from getagrip.studio.masks.propagate_frame import Hands, Images

MAX_KEPT_BYTES = 64 * 2**20
"""Size of all kept maps, compressed; the oldest ones are dropped."""
COMPRESSION_LEVEL = 1


class _KeptMap(NamedTuple):
    basis: str
    content: bytes
    shape: tuple[int, ...]
    confidence: float


class FilledMaps:
    """The newest label map of each frame of each grasp, with a checksum of what it is made of (``basis``)."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, int], _KeptMap] = OrderedDict()
        self._bytes = 0

    def put(self, grasp: str, basis: str, made: PropagatedLabels) -> None:
        """Keep the label map of a frame in place of an older one."""
        key, content = (grasp, made.frame), zlib.compress(made.labels.tobytes(), COMPRESSION_LEVEL)
        self._drop(key)
        self._kept[key] = _KeptMap(basis, content, made.labels.shape, made.confidence)
        self._bytes += len(content)
        while self._bytes > MAX_KEPT_BYTES:
            self._drop(next(iter(self._kept)))

    def get(self, grasp: str, frame: int, basis: str | None) -> _KeptMap | None:
        """Return what is kept of a frame; None where nothing is, or it is made of something else."""
        kept = self._kept.get((grasp, frame))
        return kept if kept is not None and kept.basis == basis else None

    def _drop(self, key: tuple[str, int]) -> None:
        if (old := self._kept.pop(key, None)) is not None:
            self._bytes -= len(old.content)


@dataclass(frozen=True)
class FilledFrames:
    """The kept label maps of a grasp that are made of its current labels."""

    maps: FilledMaps
    grasp: str
    bases: Mapping[int, str]
    """Checksum of what a frame's map would be made of now."""

    def __contains__(self, frame: object) -> bool:
        return isinstance(frame, int) and self.maps.get(self.grasp, frame, self.bases.get(frame)) is not None

    def at(self, frame: int) -> PropagatedLabels | None:
        """Return the label map of a frame; None where none is kept."""
        if (kept := self.maps.get(self.grasp, frame, self.bases.get(frame))) is None:
            return None
        labels = np.frombuffer(zlib.decompress(kept.content), np.uint8).reshape(kept.shape)
        return PropagatedLabels(frame, labels.copy(), kept.confidence)


NOTHING_FILLED = FilledFrames(FilledMaps(), "", {})


def propagate_missing(
    image: Images,
    keys: Mapping[int, UInt8[ndarray, "H W"]],
    first: int,
    last: int,
    filled: FilledFrames,
    hand: Hands,
) -> Iterator[PropagatedLabels]:
    """Yield the label maps of ``propagate_labels``; those of spans that are wholly ``filled`` are taken from there."""
    made = propagate_labels(image, keys, first, last, filled, hand)
    following = next(made, None)
    for n in range(first, last + 1):
        if following is not None and following.frame == n:
            yield following
            following = next(made, None)
        elif (kept := filled.at(n)) is not None:
            yield kept
