"""Hand occlusion, where no mask says so: the given hand, drawn over the object."""

from __future__ import annotations

import numpy as np

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3


def occluded_by_hand(clip: Clip, masks: Masks) -> Masks:
    """Masks whose ignored pixels are those that the clip's hand covers and the object's mask does not."""
    from getagrip.geometry.depth import covered

    ignore = np.empty_like(masks.ignore)
    vertices = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)
    for n, K in enumerate(clip.K):
        ignore[n] = covered(vertices[n], clip.hand.faces, K, clip.size)
    return Masks(masks.object, ignore & ~masks.object)
