"""Stable contact in the grasps of a timeline: in its other frames no hand need touch the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from getagrip.clip import Clip
from getagrip.evaluation.metric import SCA
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import ContactDefinition, contact_distances, stable_contact
from getagrip.metrics.pose import ObjectTrack


def contact_in_grasps(
    clip: Clip, found: Mesh, track: ObjectTrack, contacts: Sequence[ContactDefinition], reach: float
) -> dict[str, float]:
    """Compute SCA by the metric's key, mean over the grasps of a timeline; each with the hand of its side.

    ``clip`` has the hands that were found, ``track`` poses the mesh that was found in the clip's own one. ``reach`` is
    up to where distances are exact [m]. Empty where no grasp has two frames in which its hand is known.
    """
    each = []
    for segment in clip.segments:
        by, rows = clip.with_side(segment.side), segment.rows[clip.hand_known(segment.side)[segment.rows]]
        if segment.state != "grasp" or by is None or len(rows) < 2:
            continue
        hand = by.hand.take(rows)
        T_hand_obj = se3.inverse(hand.T_cam_hand) @ clip.hand.T_cam_hand[rows] @ track.T_ref_obj[rows]
        track_in_hand = ObjectTrack(T_hand_obj, track.scale)
        (distances,) = contact_distances(found, [track_in_hand], hand.vertices, hand.faces, reach)
        each.append([stable_contact(distances, contact).sca for contact in contacts])
    if not each:
        return {}
    return dict(zip((SCA.key(contact) for contact in contacts), np.mean(each, axis=0).tolist(), strict=True))
