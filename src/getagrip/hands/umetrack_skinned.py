"""A person's UmeTrack hand as a ``HandModel``, so that MANO's pose numbers drive it and ``fit_joints`` can fit it.

UmeTrack's twenty hinges become MANO's fifteen ball joints: the two hinges at the root of a finger, a few millimetres
apart, become one joint at the second. Fits to spread fingers are therefore off by a millimetre or two; HOT3D's recorded
angles belong to ``UmeTrackHand.with_pose``, which is exact.
"""

from __future__ import annotations

import numpy as np

from getagrip.geometry import se3
from getagrip.hands.generic_skeleton import WRIST
from getagrip.hands.model import KNUCKLES, HandModel, Side, mirrored, mirrored_model
from getagrip.hands.umetrack import T_world_hand, UmeTrackHand

SIZE_SPREAD = 0.1
"""Standard deviation of the one shape parameter, the size relative to the person's."""


def skinned(hand: UmeTrackHand, side: Side) -> HandModel:
    """The hand with MANO's joint tree, in the package's hand frame; its only shape parameter is ``size``."""
    if side == "right":
        return mirrored_model(skinned(hand, "left"))
    T_hand_wrist = se3.inverse(T_world_hand("left", np.eye(4)))
    vertices, tips = (se3.transform(T_hand_wrist, X) for X in (hand.rest.vertices, hand.tips))
    pivots = se3.transform(T_hand_wrist, hand.pivots).reshape(5, 4, 3)
    joints, weights = np.zeros((16, 3)), np.zeros((len(vertices), 16))
    joints[0], weights[:, 0] = mirrored(WRIST), hand.weights[:, :2].sum(axis=1)
    for n, knuckle in enumerate(KNUCKLES):
        joints[knuckle : knuckle + 3] = pivots[n, 1:]
        weights[:, knuckle : knuckle + 3] = hand.weights[:, 2 + 3 * n : 5 + 3 * n]
    return HandModel(
        name="umetrack",
        side="left",
        template=vertices,
        faces=hand.rest.faces,
        joints=joints,
        weights=weights,
        tips=np.argmin(np.linalg.norm(vertices - tips[:, None], axis=2), axis=1),
        regions=hand.regions,
        shape_names=("size",),
        shape_directions=(vertices - joints[0])[..., None],
        joint_directions=(joints - joints[0])[..., None],
        shape_spread=np.array([SIZE_SPREAD]),
    )
