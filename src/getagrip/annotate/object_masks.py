"""The object's masks without a page: from a box, strokes or masks on some frames to every frame of a clip."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.annotate.carried_masks import Hands, Images
from getagrip.annotate.labelled import beside_hand
from getagrip.annotate.propagated_masks import propagate
from getagrip.annotate.strokes import Box, boxed
from getagrip.errors import UsageError
from getagrip.io.images import write_image


class Written(NamedTuple):
    """Masks of a clip's frames."""

    confidence: dict[int, float]
    """By frame, 1 where it was given."""

    @property
    def least_sure(self) -> int:
        """The frame on which a mask would help most."""
        return min(self.confidence, key=self.confidence.__getitem__)


def key_of_box(image: Images, box: Box, frame: int, hand: Hands) -> dict[int, UInt8[ndarray, "H W"]]:
    """The label map of a frame whose object fills a box (left, top, width, height) [px].

    Raises ``UsageError`` for a box that is not in the image, and where no object is found in it.
    """
    labels = boxed(image(frame), box, hand(frame))
    if not (labels == 1).any():
        raise UsageError(f"--object-box: no object stands out in it on frame {frame + 1}: take it closer, or draw")
    return {frame: labels}


def write_masks(
    image: Images,
    keys: Mapping[int, UInt8[ndarray, "H W"]],
    first: int,
    last: int,
    hand: Hands,
    folder: Path,
    done: Callable[[int], None] = lambda _: None,
) -> Written:
    """Write ``folder/<place>.png``, places from 1: 1 the object, 2 what may hide it, 3 the hand.

    Of the frames ``first`` to ``last``, from 0 and both included, that the ``keys`` show some of. ``done`` is called
    with the number of masks that are written.
    """
    confidence: dict[int, float] = {}
    for n, labels, sure in propagate(image, keys, first, last, hand=hand):
        write_image(folder / f"{n + 1:06d}.png", beside_hand(np.asarray(labels, np.uint8)))
        confidence[n] = sure
        done(len(confidence))
    return Written(confidence)
