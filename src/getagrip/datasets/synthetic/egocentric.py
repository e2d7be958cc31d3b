"""The view of a head-worn camera of a hand that carries something, and of the other hand that comes in front."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.datasets.synthetic.grasp import Grasper
from getagrip.geometry import se3
from getagrip.hands.model import mirrored


def draw_egocentric_poses(
    T_hand_obj: Float[ndarray, "4 4"],
    middle: Float[ndarray, "3"],
    diameter: float,
    frames: int,
    rng: np.random.Generator,
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
    """Draw ``T_world_cam`` and ``T_world_hand`` of a hand that lifts, carries and tilts, before a head that follows it.

    World: x right, y ahead, z up, the middle of hand and object near the origin. The object starts upright, turned
    such that the forearm comes from the right shoulder.
    """
    forearm = (T_hand_obj[:3, :3].T @ [1.0, 0.0, 0.0])[:2]
    yaw = np.arctan2(-0.8, 0.6) - np.arctan2(forearm[1], forearm[0]) + rng.normal(0.0, 0.25)
    upright = se3.exp_so3(np.array([0.0, 0.0, yaw])) @ T_hand_obj[:3, :3].T
    tilt = np.radians(rng.uniform(15.0, 45.0)) * draw_smooth_curves(rng, frames, 3)
    carried = np.array([0.06, 0.04, 0.05]) * draw_smooth_curves(rng, frames, 3)
    T_world_hand = rotate_about_point(np.zeros(3), tilt, carried) @ se3.rigid(upright, -upright @ middle)

    away = np.clip(0.24 + 1.05 * diameter, 0.36, 0.62)
    down = np.radians(rng.uniform(30.0, 60.0))
    eye = away * np.array([0.0, -np.cos(down), np.sin(down)]) + 0.025 * draw_smooth_curves(rng, frames, 3)
    target = 0.6 * carried + 0.02 * draw_smooth_curves(rng, frames, 3)
    z = target - eye
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) + 0.06 * draw_smooth_curves(rng, frames, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    T_world_cam = se3.rigid(np.stack([x, np.cross(z, x), z], axis=-1), eye)
    return T_world_cam, T_world_hand


def draw_other_hand(
    grasper: Grasper, T_cam_hand: Float[ndarray, "T 4 4"], middle: Float[ndarray, "3"], rng: np.random.Generator
) -> Float[ndarray, "T V 3"]:
    """Draw a relaxed left hand that drifts over part of the object, in the camera frame [m]."""
    frames = len(T_cam_hand)
    relaxed = np.radians([(0.0, 10.0, 10.0), *((25.0, 30.0, 15.0),) * 4])
    vertices = mirrored(grasper.posed(relaxed).vertices)
    vertices = vertices - vertices.mean(axis=0)
    turn = se3.exp_so3(rng.normal(0.0, 0.25, 3))
    # Seen from the head: back of the hand towards the eye, fingers up and to the right.
    facing = np.array([[-0.45, 0.0, 0.9], [-0.9, 0.0, -0.45], [0.0, -1.0, 0.0]]).T
    usual = se3.transform(T_cam_hand, middle[None])[:, 0].mean(axis=0)
    place = usual * rng.uniform(0.72, 0.82) + np.array([-0.09, 0.03, 0.0])
    moves = rotate_about_point(
        np.zeros(3), 0.2 * draw_smooth_curves(rng, frames, 3), 0.03 * draw_smooth_curves(rng, frames, 3)
    )
    return se3.transform(se3.rigid(None, place) @ moves, vertices @ (turn @ facing).T)


def draw_smooth_curves(rng: np.random.Generator, frames: int, curves: int) -> Float[ndarray, "T curves"]:
    """Draw random slow curves with values in [-1, 1]: a few low frequencies over the clip."""
    t = np.linspace(0.0, 1.0, frames)[:, None, None]
    frequency = np.pi * np.array([1.0, 2.0, 3.0])[:, None]
    amplitude = rng.normal(size=(3, curves)) / np.array([1.0, 2.0, 4.0])[:, None]
    curve = np.sum(amplitude * np.sin(frequency * t + rng.uniform(0.0, 2.0 * np.pi, (3, curves))), axis=1)
    return np.asarray(curve / np.abs(amplitude).sum(axis=0))


def rotate_about_point(
    point: Float[ndarray, "3"], turn: Float[ndarray, "T 3"], shift: Float[ndarray, "T 3"]
) -> Float[ndarray, "T 4 4"]:
    """Turn by rotation vectors [rad] about a point, then shift [m]."""
    R = se3.exp_so3(turn)
    return se3.rigid(R, point + shift - R @ point)
