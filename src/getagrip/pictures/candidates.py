"""Another candidate of a result in the result's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import diameter
from getagrip.grasps.approximation import pose_hinge
from getagrip.pictures.shown import View
from getagrip.result import Axis


def candidate(view: View, rank: int) -> View:
    """Return the result for rank 0; else the candidate, with the axis that fits its poses best, and without an IOU."""
    if rank == 0:
        return view
    found = view.result
    T_hand_obj, scale = found.candidates.T_hand_obj[rank], float(found.candidates.scale[rank])
    axis = None if found.axis is None else hinge(T_hand_obj, scale * view.clip.mesh.vertices)
    other = replace(
        found, T_hand_obj=T_hand_obj, scale=scale, iou=np.full(len(found.frames), np.nan), axis=axis,
        findings=(), probability_right=None, probability_right_in_camera=None,
    )  # fmt: skip
    return replace(view, result=other)


def hinge(T_hand_obj: Float[ndarray, "T 4 4"], vertices: Float[ndarray, "V 3"]) -> Axis | None:
    """Fit the axis about which poses turn best (Eq. 4), with the angles from the first frame on.

    None for a single pose.
    """
    if len(T_hand_obj) < 2:
        return None
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    best = pose_hinge(R, c, diameter(vertices) / 2.0)
    angle = np.unwrap(best.angles(R, c))
    return Axis(point=best.point, direction=best.direction, angle=angle - angle[0])
