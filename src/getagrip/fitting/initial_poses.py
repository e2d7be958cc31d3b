"""Initial poses: those that are given, then a uniform grid of rotations over SO(3), placed by the hand and the masks.

The ground truth is never used.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, HandTrack, Masks
from getagrip.fitting.motion import Fixed
from getagrip.geometry import camera, se3


def initial_poses(
    clip: Clip,
    masks: Masks,
    inits: int,
    seed: int = 0,
    poses: Float[ndarray, "k 4 4"] | None = None,
    usual: Float[ndarray, "u 3 3"] | None = None,
) -> Fixed:
    """Return B = ``inits`` poses: the first of ``poses`` (``T_hand_obj``), then rotations spread uniformly over SO(3).

    ``usual`` rotations come first among the latter, half of them at most.

    The latter place the object's centre at ``grip_point``. A free scale is initialised so that the object at that
    place is as large as its masks.
    """
    poses = np.zeros((0, 4, 4)) if poses is None else poses[:inits]
    offset = se3.exp_so3(np.random.default_rng(seed).uniform(-1.0, 1.0, 3)) if seed else np.eye(3)
    usual = np.zeros((0, 3, 3)) if usual is None else usual[: (inits - len(poses)) // 2]
    R = np.concatenate([usual, offset @ se3.super_fibonacci(inits - len(poses) - len(usual))])
    boxes = camera.bounding_boxes(masks.object).astype(float)
    point = grip_point(clip.hand, clip.K, (boxes[:, :2] + boxes[:, 2:]) / 2.0)
    scale = 1.0
    if clip.scale == "free":
        depth = se3.transform(clip.hand.T_cam_hand, point[None, None])[:, 0, 2]
        extent = np.linalg.norm(boxes[:, 2:] - boxes[:, :2], axis=1) * depth / clip.K[:, 0, 0]
        scale = float(np.clip(np.median(extent) / clip.mesh.diameter, 0.2, 5.0))
    centre = np.concatenate([se3.transform(poses, scale * clip.mesh.centre[None])[:, 0], np.tile(point, (len(R), 1))])
    R = np.concatenate([poses[:, :3, :3], R])
    return Fixed(R, centre, np.full(inits, np.log(scale)), len(clip), clip.scale == "free")


def grip_point(hand: HandTrack, K: Float[ndarray, "T 3 3"], uv: Float[ndarray, "T 2"]) -> Float[ndarray, "3"]:
    """Return the point of the hand frame nearest to the rays through the masks' centres and to the hand's grip [m].

    The grip is the mean of the five fingertips' contact regions, with a standard deviation of 5 cm. The rays have 2 cm;
    together they count as four, since occlusion by the hand biases all of them alike.
    """
    grip = np.mean([hand.vertices[:, hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS], axis=0)
    R_hand_cam = np.swapaxes(hand.T_cam_hand[:, :3, :3], 1, 2)
    eye = -(R_hand_cam @ hand.T_cam_hand[:, :3, 3, None])[..., 0]
    ray = (R_hand_cam @ camera.backproject(K, uv[:, None])[:, 0, :, None])[..., 0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    orthogonal = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    ray_weight, grip_weight = 4.0 / (len(ray) * 0.02**2), 1.0 / 0.05**2
    A = ray_weight * orthogonal.sum(axis=0) + grip_weight * np.eye(3)
    return np.linalg.solve(A, ray_weight * (orthogonal @ eye[..., None])[..., 0].sum(axis=0) + grip_weight * grip)
