"""What the 3D view of a page holds: surfaces, where they touch, and poses in each frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import OtherHand
from getagrip.view.shown import View
from getagrip.view.stills import smoothed
from getagrip.view.tiles import axis_points
from getagrip.view.touched import touched

CONTACT = 0.010
"""Surfaces nearer to each other than this are shown as in contact [m]."""
FOLLOWED = 0.35
"""The camera looks at the mean place of hand and object over this time [s]."""


def arrays(view: View) -> dict[str, ndarray]:
    """Arrays by their names, as ``parts/viewer.js`` reads them; metres, poses as 4x4 matrices.

    ``object_vertices`` are those of the mesh as it is, to be scaled by ``scale``, one for each candidate; the hand's
    are in the hand frame, in each frame. ``object_contact`` and ``hand_contact`` go from 0 to 255, in contact.
    Where there is a hand of the other side, it has arrays of its own, and ``other_hand_known`` is 1 in its frames.
    ``T_hand_obj`` has those of the candidates one after another. ``focus`` is where to look, in the camera frame of
    each image.
    """
    result, hand = view.result, view.clip.hand
    on_object, on_hand = touched(view, CONTACT)
    hands = [np.mean([vertices.mean(axis=0) for vertices, _ in view.hands(n)], axis=0) for n in range(len(view.clip))]
    middles = [(hand + _middle(view.object(n))) / 2.0 for n, hand in enumerate(hands)]
    focus = smoothed(np.array(middles), FOLLOWED * view.clip.fps)
    out: dict[str, ndarray] = {
        "object_vertices": on_object.vertices[0] / result.scale,
        "object_faces": on_object.faces,
        "object_contact": on_object.contact,
        "hand_vertices": hand.vertices,
        "hand_faces": hand.faces,
        "hand_contact": on_hand.contact,
        "T_cam_hand": hand.T_cam_hand,
        "T_hand_obj": result.candidates.T_hand_obj,
        "scale": result.candidates.scale,
        "focus": focus,
    }
    if view.clip.other_hand is not None:
        out |= _other_hand(view, view.clip.other_hand, out["object_contact"])
    if result.axis is not None:
        out["axis"] = axis_points(view)[[0, -1]]
    if view.clip.world is not None:
        out["T_world_cam"] = view.clip.world.T_world_cam
    if view.clip.truth is not None:
        out["true_T_cam_obj"] = view.clip.truth.T_cam_obj
        out["true_scale"] = np.array([view.clip.truth.scale])
    return {name: _small(name, values) for name, values in out.items()}


def _other_hand(view: View, hand: OtherHand, object_contact: Float[ndarray, "T V"]) -> dict[str, ndarray]:
    """The arrays of the hand of the other side; what it touches is added to the object's contact."""
    contact = np.zeros(hand.track.vertices.shape[:2])
    if (seen := view.by_other_hand()) is not None:
        on_object, on_hand = touched(seen, CONTACT)
        contact[hand.known] = on_hand.contact
        object_contact[hand.known] = np.maximum(object_contact[hand.known], on_object.contact)
    return {
        "other_hand_vertices": hand.track.vertices,
        "other_hand_faces": hand.track.faces,
        "other_hand_contact": contact,
        "other_hand_known": hand.known,
        "T_cam_other_hand": hand.track.T_cam_hand,
    }


def _middle(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "3"]:
    """Of the bounding box."""
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2.0)


def _small(name: str, values: ndarray) -> ndarray:
    """Values in the smallest of a page's types that will do."""
    if name.endswith("_contact"):
        return np.round(255.0 * values).astype(np.uint8)
    if name.endswith("_known"):
        return values.astype(np.uint8)
    if name.endswith("_faces"):
        return values.astype(np.uint16 if values.max(initial=0) < 2**16 else np.uint32)
    return values.astype(np.float32)
