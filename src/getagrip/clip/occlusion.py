"""Hand occlusion, where no mask says so: the given hands, drawn over the object."""

from __future__ import annotations

import numpy as np

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3


def occluded_by_hand(clip: Clip, masks: Masks) -> Masks:
    """Masks whose ignored pixels are those that the clip's hands cover and the object's mask does not."""
    from getagrip.geometry.depth import covered

    ignore = np.zeros_like(masks.ignore)
    hands = [(clip.hand, np.arange(len(clip)))]
    if clip.other_hand is not None:
        hands.append((clip.other_hand.track, np.flatnonzero(clip.other_hand.known)))
    for hand, rows in hands:
        vertices = se3.transform(hand.T_cam_hand, hand.vertices)
        for n in rows:
            ignore[n] |= covered(vertices[n], hand.faces, clip.K[n], clip.size)
    return Masks(masks.object, ignore & ~masks.object)
