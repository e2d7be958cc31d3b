"""How well a motion over a timeline meets the true one: each segment's poses, the jumps between them, contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.metrics.contact import ContactDefinition, contact_distances, stable_contact
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import Symmetries

CONTACT = ContactDefinition("object", 0.010)
KINDS = {"static": "static", "contact": "between", "free": "between", "grasp": "grasp"}
"""Words for the states of segments in tables."""


@dataclass(frozen=True)
class SegmentScore:
    """A segment's poses in the camera frame.

    Attributes:
        kind: of ``KINDS``.
        right: whether its mean ADD is below a tenth of the diameter.
        right_sym: the same up to the object's symmetries.
        add_sym: that mean, in diameters.
        sca: of grasps, else None.
    """

    kind: str
    right: bool
    right_sym: bool
    add_sym: float
    sca: float | None


def segment_scores(
    clip: Clip, symmetries: Symmetries, T_cam_obj: Float[ndarray, "T 4 4"], T_cam_hand: Float[ndarray, "T 4 4"]
) -> list[SegmentScore]:
    """Score each segment; contact is with the hand of the result. The clip's scale is known."""
    assert clip.truth is not None
    out = []
    for segment in clip.segments:
        rows = segment.rows
        found, true = ObjectTrack(T_cam_obj[rows], 1.0), ObjectTrack(clip.truth.T_cam_obj[rows], clip.truth.scale)
        plain = pose_errors(clip.mesh, found, true)
        sym = pose_errors(clip.mesh, found, true, best_symmetry(clip.mesh, found, true, symmetries))
        sca = None
        if segment.state == "grasp":
            grasped = ObjectTrack(se3.inverse(T_cam_hand[rows]) @ T_cam_obj[rows], 1.0)
            (distances,) = contact_distances(clip.mesh, [grasped], clip.hand.vertices[rows], clip.hand.faces)
            sca = stable_contact(distances, CONTACT).sca
        share = float(sym.add.mean() / sym.diameter)
        out.append(SegmentScore(KINDS[segment.state], plain.success, sym.success, share, sca))
    return out


def jumps(clip: Clip, T_cam_obj: Float[ndarray, "T 4 4"]) -> Sequence[float]:
    """Measure the object's jump from each segment to the next beyond its true motion [m]: the mean over vertices."""
    assert clip.truth is not None
    out = []
    for one, other in zip(clip.segments, clip.segments[1:], strict=False):
        moves = [T[other.first] @ se3.inverse(T[one.last]) for T in (T_cam_obj, clip.truth.T_cam_obj)]
        posed = se3.transform(clip.truth.T_cam_obj[one.last], clip.truth.scale * clip.mesh.vertices)
        apart = se3.transform(moves[0], posed) - se3.transform(moves[1], posed)
        out.append(float(np.linalg.norm(apart, axis=1).mean()))
    return out
