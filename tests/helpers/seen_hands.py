"""Networks that see the hand of ``labelled_scene`` where it is in the first frame, or in its mirror image."""

from __future__ import annotations

import numpy as np

from getagrip.studio.hands.networks import HandNetOutput, Nets
from getagrip.studio.hands.palms import HandCrop, Palm
from helpers.labelled_scene import joints

POINTS = np.array(joints(0))


class SceneNets(Nets):
    """A left hand, detected in every frame, or nothing at all."""

    def __init__(self, hands: bool = True) -> None:
        super().__init__(lambda image: [], lambda image: [], "made up")
        object.__setattr__(self, "hands", hands)

    def palms(self, image: np.ndarray, fill: float = 1.0) -> list[Palm]:
        points = np.tile(POINTS[0], (7, 1))
        points[2] = POINTS[9]
        box = np.concatenate([POINTS[[0, 5, 17]].min(axis=0), POINTS[[0, 5, 17]].max(axis=0)])
        return [Palm(box, points, 0.9)] if self.hands else []  # type: ignore[attr-defined]

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        return HandNetOutput(POINTS, np.full((21, 3), np.nan), 0.95, 0.01)

    def mirrored(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        return self.landmarks(image, crop)._replace(right=0.99)
