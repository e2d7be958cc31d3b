"""Hand occlusion where no mask shows it: the input hands, drawn over the object."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3
from getagrip.io.packed_masks import PackedMasks


def occluded_by_hand(clip: Clip, masks: Masks) -> Masks:
    """Ignore the pixels that the clip's hands cover and the object's mask does not.

    Of a frame whose mask is not known, all still are.
    """
    from getagrip.geometry.depth import render_coverage

    hands = [(clip.hand, np.ones(len(clip), dtype=bool))]
    if clip.other_hand is not None:
        hands.append((clip.other_hand.track, clip.other_hand.known))
    posed = [(se3.transform(hand.T_cam_hand, hand.vertices), hand.faces, known) for hand, known in hands]

    unknown = ~masks.known

    def hidden(n: int, visible: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
        if unknown[n]:
            return np.ones_like(visible)
        ignore = np.zeros_like(visible)
        for vertices, faces, known in posed:
            if known[n]:
                ignore |= render_coverage(vertices[n], faces, clip.K[n], clip.size)
        return ignore & ~visible

    return Masks(masks.object, PackedMasks.of(map(hidden, range(len(clip)), masks.object), clip.size).as_array())
