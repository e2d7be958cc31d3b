"""Forms, sizes and distances that cannot be far from usual while a hand holds an object, and the side of a hand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.geometry.mesh import face_areas
from getagrip.metrics.surface_distance import close_holes

UNKNOWN_VALUE = float("nan")


def size_at_scale(it: Evidence, scale: str, size: float) -> float:
    """Return a relative size where the object's size is "known", or where it is "free"; elsewhere it says nothing."""
    return size if it.clip.scale == scale else UNKNOWN_VALUE


def lifted_hand_size(it: Evidence) -> float:
    """Return how many times as large as a mean hand a lifted one is, where depth or the object's size tells it."""
    if it.clip.size_beside_hand:
        return 1.0 / it.scale
    return UNKNOWN_VALUE if it.clip.hand_scale == 1.0 else it.clip.hand_scale


def edge_share(it: Evidence) -> float:
    """Measure the share of the image's edge that the masks cover, median over frames; all of it for the background."""
    each = [(mask[[0, -1]].mean(), mask[:, [0, -1]].mean()) for mask in it.masks.object]
    edges = np.array(each).T
    width, height = it.clip.size
    return float(np.median((width * edges[0] + height * edges[1]) / (width + height)))


def focal_jump(it: Evidence) -> float:
    """Return the largest factor by which the focal length changes from one frame to the next."""
    steps = np.abs(np.diff(np.log(it.clip.K[:, [0, 1], [0, 1]]), axis=0))
    return float(np.exp(steps.max(initial=0.0)))


def median_hand_object_gap(it: Evidence) -> float:
    """Measure the smallest distance of hand and object, median over frames [mm]; 0 where they touch."""
    return 1e3 * float(np.median(np.maximum(it.to_object.min(axis=1), 0.0)))


def penetration_depth(it: Evidence) -> float:
    """Measure the depth of the hand's deepest point inside the object, median over frames [mm]."""
    return 1e3 * float(np.median(np.maximum(-it.to_object.min(axis=1), 0.0)))


def second_contact_gap(it: Evidence) -> float:
    """Measure the distance of the second nearest contact region of the hand, median over frames [mm].

    0 where it touches.
    """
    regions = it.region_distance
    return (
        1e3 * float(np.median(np.maximum(np.sort(regions, axis=1)[:, 1], 0.0)))
        if regions.shape[1] > 1
        else UNKNOWN_VALUE
    )


def hole_share(it: Evidence) -> float:
    """Compute the share of the holes in the area of mesh and holes together; holes are closed by fans."""
    mesh = it.clip.mesh
    area = face_areas(*close_holes(mesh.vertices, mesh.faces))
    return float(area[len(mesh.faces) :].sum() / area.sum())


def extents(it: Evidence) -> list[float]:
    """Return the sides of the box around the mesh along its principal axes, as shares of the largest; it comes last."""
    about = it.clip.mesh.vertices - it.clip.mesh.vertices.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(about.T))
    sides = np.sort(np.ptp(about @ axes, axis=0))
    return np.asarray(sides / sides[-1]).tolist()


WRIST_JOINT, INDEX_MCP, MIDDLE_MCP, PINKY_MCP = 0, 5, 9, 17
"""Indices among the 21 joints: the wrist, and the first joints of three fingers."""
FOUR_FINGER_MCP_JOINTS, FOUR_FINGERTIP_JOINTS = np.array([5, 9, 13, 17]), np.array([8, 12, 16, 20])


def finger_bend(it: Evidence) -> float:
    """Measure how far the fingers bend towards the palm of a hand of the clip's side, median over frames [degrees].

    Negative where they would bend backwards: it is the other hand. NaN for hands without joints.

    Seen with the palm in front and the fingers up, a right hand's index lies to the right of its little finger; so
    little finger to index, crossed with wrist to fingers, points out of the palm, where bent fingers go.
    """
    joints = it.clip.hand.joints
    if joints is None:
        return UNKNOWN_VALUE
    along = _normalize(joints[:, MIDDLE_MCP] - joints[:, WRIST_JOINT])
    out = _normalize(np.cross(joints[:, INDEX_MCP] - joints[:, PINKY_MCP], along))
    fingers = (joints[:, FOUR_FINGERTIP_JOINTS] - joints[:, FOUR_FINGER_MCP_JOINTS]).mean(axis=1)
    angle = np.degrees(np.arctan2(np.sum(fingers * out, axis=1), np.abs(np.sum(fingers * along, axis=1))))
    return float(np.median(angle if it.clip.side == "right" else -angle))


def _normalize(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))
