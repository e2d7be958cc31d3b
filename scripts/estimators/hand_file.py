"""Hands as ``hand.npz``, for all estimators' scripts: plain numpy, copied next to them into any environment.

Conventions: metres; camera axes x right, y down, z forward. The hand frame is MANO's at zero global rotation, so that
``T_cam_hand = [R | J0 - R J0 + t]`` with MANO's global rotation R, its translation t and its root joint J0.
"""

import numpy as np

FINGERS = {"thumb": 13, "index": 1, "middle": 4, "ring": 10, "pinky": 7}
"""Index of each finger's first joint among MANO's 16."""
MIRROR = np.array([-1.0, 1.0, 1.0])


def contact_regions(template, joints, faces, weights):
    """Return the contact regions of MANO's flat right hand, vertex ids by name: five fingertips, three of the palm.

    template (778, 3), joints (16, 3), faces (F, 3), skinning weights (778, 16). Pads are the vertices of the last
    phalanges that face as the finger does. Of the palm: the ball of the thumb, the cushions below the fingers' roots,
    the edge below the little finger. The rules are those of getagrip.hands.model.
    """
    a, b, c = np.moveaxis(template[faces], 1, 0)
    normals = np.zeros_like(template)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    regions = {}
    for finger, first in FINGERS.items():
        along = joints[first + 2] - joints[first + 1]
        along /= np.linalg.norm(along)
        facing = np.array([0.0, -1.0, -2.0 if finger == "thumb" else 0.0])
        facing -= (facing @ along) * along
        facing /= np.linalg.norm(facing)
        regions[finger] = np.flatnonzero((weights[:, first + 2] > 0.5) & (normals @ facing > 0.2))
    wrist, index, pinky = joints[0], joints[FINGERS["index"]], joints[FINGERS["pinky"]]
    length = (template - wrist)[:, 0] / (0.5 * (index + pinky) - wrist)[0]  # 0 at the wrist, 1 at the knuckles
    across = (template - index) @ (pinky - index) / np.sum((pinky - index) ** 2)  # 0 at the index, 1 at the pinky
    palm, down = weights[:, 0] > 0.5, -normals[:, 1]  # the palm faces -y
    below_thumb = palm | (weights[:, FINGERS["thumb"]] > 0.5)
    below_fingers = palm | (weights[:, [FINGERS[name] for name in ("index", "middle", "ring", "pinky")]] > 0.5).any(
        axis=1
    )
    inside = {
        "palm_thumb": below_thumb & (down > 0.2) & (length > 0.1) & (length < 0.75) & (across < 0.35),
        "palm_fingers": below_fingers & (down > 0.5) & (length > 0.75) & (length < 1.1),
        "palm_edge": palm & (down > -0.3) & (length > 0.2) & (length <= 0.75) & (across > 0.85),
    }
    return regions | {name: np.flatnonzero(vertices) for name, vertices in inside.items()}


def translation(cam, centre, side, K):
    """Compute MANO's translation in a pinhole camera K from (s, tx, ty) in a crop with a middle and a side [px].

    A crop shows b s / 2 pixels to the metre, the hand's origin at centre + (b s / 2) (tx, ty); tx as in the image, not
    as in a mirrored crop.
    """
    scale = side * cam[0] / 2.0
    z = K[0, 0] / scale
    u, v = centre + scale * np.asarray(cam[1:])
    return np.array([z * (u - K[0, 2]) / K[0, 0], z * (v - K[1, 2]) / K[1, 1], z])


def hand_frame(vertices, root, R, t, side):
    """Make one frame's hand from a network's output, a right hand's; for a left hand, of the mirrored crop.

    vertices (N, 3): turned by R (3, 3) about the root joint (3,), without translation; t (3,): ``translation``. Returns
    the vertices in the hand frame, and T_cam_hand (4, 4), of the hand as it is.
    """
    flat = (vertices - root) @ R + root
    if side == "left":
        flat, root, R = flat * MIRROR, root * MIRROR, MIRROR[:, None] * R * MIRROR
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, root - R @ root + t
    return flat, T


def at_object(boxes, rights, side, near, last):
    """Return the index of the grasping hand among boxes (n, 4), corners x0, y0, x1, y1 [px]; None without one.

    ``rights`` (n,) are above 0.5 for right hands, ``side`` is the stated one or None. ``near`` is the object's box, if
    it is known in this image: the hand nearest to it, of the stated side if one of that side is at it. Else of the
    stated side that nearest to ``last``, the hand's box in the image before; else the largest.
    """
    boxes = np.asarray(boxes, dtype=float).reshape(-1, 4)
    middle, size = 0.5 * (boxes[:, :2] + boxes[:, 2:]), boxes[:, 2:] - boxes[:, :2]
    known = np.ones(len(boxes), dtype=bool)
    if side is not None:
        known = (np.asarray(rights) > 0.5) == (side == "right")
    cost = -size.prod(axis=1)
    if near is not None:
        near = np.asarray(near, dtype=float)
        gap = np.linalg.norm(np.maximum(0.0, np.maximum(near[:2] - boxes[:, 2:], boxes[:, :2] - near[2:])), axis=1)
        at = known & (gap <= size.max(axis=1))
        known = at if at.any() else np.ones(len(boxes), dtype=bool)
        cost = 1e3 * gap + np.linalg.norm(middle - 0.5 * (near[:2] + near[2:]), axis=1)
    elif last is not None:
        cost = np.linalg.norm(middle - 0.5 * (np.asarray(last)[:2] + np.asarray(last)[2:]), axis=1)
    return int(np.where(known, cost, np.inf).argmin()) if known.any() else None


def side_of(rights, side):
    """Return the stated side, else the side of most detections; ``rights`` are above 0.5 for right hands."""
    if side is not None or not len(rights):
        return side
    return "right" if np.mean(np.asarray(rights) > 0.5) > 0.5 else "left"


def write(path, vertices, joints, T_cam_hand, faces, regions, side, frames, K, camera):
    """Write the file.

    vertices (T, 778, 3) and joints (T, 21, 3) in the hand frame, T_cam_hand (T, 4, 4), faces (F, 3) of the right hand,
    ``contact_regions``, frames (T,) whole numbers, K (3, 3); ``camera`` says in words where K is from: with the
    word "guess" in them if it is one.
    """
    faces = np.asarray(faces, dtype=np.int64)
    np.savez_compressed(
        path,
        vertices=np.asarray(vertices, dtype=float),
        joints=np.asarray(joints, dtype=float),
        T_cam_hand=np.asarray(T_cam_hand, dtype=float),
        faces=faces[:, ::-1] if side == "left" else faces,
        frames=np.asarray(frames, dtype=np.int64),
        K=np.asarray(K, dtype=float),
        side=np.array(side),
        provenance_camera=np.array(camera),
        **{f"region_{name}": ids for name, ids in regions.items()},
    )
