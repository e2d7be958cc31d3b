"""Contact regions of a skinned hand at rest: the pads of the fingertips and three areas of the palm.

They follow from skinning weights, normals and joints, so any hand model with bones has them. The areas of the palm are,
as in objects-along-hit, the ball of the thumb, the cushions below the fingers' roots, and the edge below the little
finger.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.hands.model import PALM_REGIONS

MIN_BONE_WEIGHT = 0.5
"""A vertex belongs to a bone that has more than this share of its weight."""


def contact_regions(
    of_palm: Float[ndarray, "V"],
    of_fingers: Float[ndarray, "V 5 3"],
    towards_pads: Float[ndarray, "V 5"],
    towards_palm: Float[ndarray, "V"],
    length: Float[ndarray, "V"],
    across: Float[ndarray, "V"],
) -> dict[str, Int[ndarray, "_"]]:
    """Return vertex ids of the five ``FINGERS``' pads and of the ``PALM_REGIONS``.

    ``of_palm`` and ``of_fingers`` are skinning weights, the latter of three bones for each of the ``FINGERS``.
    ``towards_pads`` and ``towards_palm`` are the components of the unit normals in the direction that each last phalanx
    and the palm face. ``length`` and ``across`` say where on the palm a vertex lies (``position_on_palm``).
    """
    palm, bones = of_palm > MIN_BONE_WEIGHT, of_fingers > MIN_BONE_WEIGHT
    pads = [bones[:, n, 2] & (towards_pads[:, n] > 0.2) for n in range(len(FINGERS))]
    below_thumb, below_fingers = palm | bones[:, 0, 0], palm | bones[:, 1:, 0].any(axis=1)
    ball = below_thumb & (towards_palm > 0.2) & (length > 0.1) & (length < 0.75) & (across < 0.35)
    cushions = below_fingers & (towards_palm > 0.5) & (length > 0.75) & (length < 1.1)
    edge = palm & (towards_palm > -0.3) & (length > 0.2) & (length <= 0.75) & (across > 0.85)
    named = zip((*FINGERS, *PALM_REGIONS), (*pads, ball, cushions, edge), strict=True)
    return {name: np.flatnonzero(inside) for name, inside in named}


def position_on_palm(
    x: Float[ndarray, "V 3"], wrist: Float[ndarray, "3"], index: Float[ndarray, "3"], pinky: Float[ndarray, "3"]
) -> tuple[Float[ndarray, "V"], Float[ndarray, "V"]]:
    """Return the position on the palm as ``length`` and ``across``.

    ``length`` is 0 at the wrist and 1 at the knuckles, along x; ``across`` is 0 below the index and 1 below the little
    finger. ``wrist``, ``index`` and ``pinky`` are the wrist and the first joints of these fingers, in the frame of
    ``x``.
    """
    length = (x - wrist)[:, 0] / (0.5 * (index + pinky) - wrist)[0]
    return length, (x - index) @ (pinky - index) / np.sum((pinky - index) ** 2)
