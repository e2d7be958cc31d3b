"""Background model: pixels matching previously seen background are not object.

The model moves with the visible surroundings, and is updated wherever the background is visible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.optical_flow import Origins, Part

GROUND_NOISE_SIGMA = 9.0
"""Standard deviation of each channel of a pixel that shows unchanged background [of 255]."""
GROUND_BIN_PROBABILITY = 0.15
"""Fraction of unchanged background pixels in the most frequent bin of their colours."""
MIN_COLOUR_PROBABILITY = 0.01
"""Probability of a colour that no pixel has shown."""
GROUND_CHANGE_RATE = 0.1, 3.0
"""Fraction of the background beside the object that has changed since it was seen: the first number, plus the second
times the fraction far from the object."""


@dataclass
class BackgroundModel:
    """An image of the background, and how far each of its pixels was seen: 0 to 1.

    Only pixels that a key frame shows count as seen: pixels that come into view later may be the object's.
    """

    image: UInt8[ndarray, "h w 3"]
    seen: Float32[ndarray, "h w"]

    @staticmethod
    def of_key(image: UInt8[ndarray, "h w 3"], visible: Bool[ndarray, "h w"]) -> BackgroundModel:
        """Begin with the ``visible`` background of a key frame."""
        return BackgroundModel(image.copy(), visible.astype(np.float32))

    def moved(self, part: Part, origins: Origins) -> BackgroundModel:
        """Return a part of the model in the next frame; ``origins`` are its pixels' places in the part now."""
        import cv2

        image = cv2.remap(self.image[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        seen = cv2.remap(self.seen[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 0.0)
        return BackgroundModel(np.asarray(image, np.uint8), np.asarray(seen, np.float32))

    def renew(
        self, image: UInt8[ndarray, "h w 3"], part: Part, moved: BackgroundModel, visible: Bool[ndarray, "y x"]
    ) -> None:
        """Replace the model by the next frame's: ``image`` outside a part, inside ``moved``, new where ``visible``."""
        import cv2

        same = visible & (cv2.absdiff(image[part], moved.image) < 2.0 * GROUND_NOISE_SIGMA).all(axis=-1)
        self.image, self.seen = image.copy(), self.seen.copy()
        self.image[part] = np.where(same[..., None], image[part], moved.image)
        self.seen[part] = moved.seen

    def unlike(
        self, image: UInt8[ndarray, "h w 3"], shares: Float32[ndarray, "2 h w"], clear: Bool[ndarray, "h w"]
    ) -> Float32[ndarray, "h w"]:
        """Return the log ratio of a pixel's probabilities on the object and on this background, 0 where unseen.

        ``shares`` are the fractions of the object's pixels, and of all others, with the pixel's colour. The less the
        background has changed where it is ``clear``, the more a changed colour is evidence of the object.
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
