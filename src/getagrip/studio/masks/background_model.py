"""The ground behind the object, as far as it was seen: a pixel that shows it again is not the object's.

It moves as the visible surroundings do, and is completed wherever the ground is visible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.optical_flow import Origins, Part

GROUND_NOISE_SIGMA = 9.0
"""Standard deviation of each channel of a pixel that shows the same again [of 255]."""
GROUND_BIN_PROBABILITY = 0.15
"""Share of such pixels that are in the most frequent bin of their colours."""
MIN_COLOUR_PROBABILITY = 0.01
"""Probability of a colour of which nothing is known."""
GROUND_CHANGE_RATE = 0.1, 3.0
"""Share of the ground beside the object that shows something else than before: the first, and a multiple of the share
far from it by the second."""


@dataclass
class BackgroundModel:
    """An image of the ground, and how far each pixel of it was seen: 0 to 1.

    Only what a key shows counts as seen: what comes into view later may be the object's.
    """

    image: UInt8[ndarray, "h w 3"]
    seen: Float32[ndarray, "h w"]

    @staticmethod
    def of_key(image: UInt8[ndarray, "h w 3"], visible: Bool[ndarray, "h w"]) -> BackgroundModel:
        """Begin with what a key shows."""
        return BackgroundModel(image.copy(), visible.astype(np.float32))

    def moved(self, part: Part, origins: Origins) -> BackgroundModel:
        """Return a part of it in the next frame, where its pixels come from ``origins`` in that part."""
        import cv2

        image = cv2.remap(self.image[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        seen = cv2.remap(self.seen[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 0.0)
        return BackgroundModel(np.asarray(image, np.uint8), np.asarray(seen, np.float32))

    def renew(
        self, image: UInt8[ndarray, "h w 3"], part: Part, moved: BackgroundModel, visible: Bool[ndarray, "y x"]
    ) -> None:
        """Replace it by the next frame's: outside a part its ``image``; in it ``moved``, renewed where ``visible``."""
        import cv2

        same = visible & (cv2.absdiff(image[part], moved.image) < 2.0 * GROUND_NOISE_SIGMA).all(axis=-1)
        self.image, self.seen = image.copy(), self.seen.copy()
        self.image[part] = np.where(same[..., None], image[part], moved.image)
        self.seen[part] = moved.seen

    def unlike(
        self, image: UInt8[ndarray, "h w 3"], shares: Float32[ndarray, "2 h w"], clear: Bool[ndarray, "h w"]
    ) -> Float32[ndarray, "h w"]:
        """Return the log ratio of a pixel's probabilities on the object and on this ground, 0 where it was not seen.

        ``shares`` are those of the object's pixels, and of the others, that have its colour. The less the ground has
        changed where it is ``clear``, the more another colour speaks for the object, even a new one.
        """
        import cv2

        now, before = (cv2.GaussianBlur(each.astype(np.float32), (0, 0), 1.0) for each in (image, self.image))
        apart = np.subtract(now, before)
        same = np.exp(-np.einsum("hwc,hwc->hw", apart, apart) / (2.0 * GROUND_NOISE_SIGMA**2))
        known = clear & (self.seen > 0.5)
        least, times = GROUND_CHANGE_RATE
        changed = min(1.0, least + times * (1.0 - float(same[known].mean()))) if known.any() else 1.0
        own, other = shares + MIN_COLOUR_PROBABILITY
        return np.asarray(self.seen * np.log(own / (GROUND_BIN_PROBABILITY * same + changed * other)), np.float32)
