"""A clip whose object turns in the hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from getagrip.clip import FINGERS, Clip, HandTrack, Truth
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from helpers.clips import small_clip


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def ball(radius: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def turning(name: str = "turning", side: str = "right") -> Clip:
    """30 frames of 50 an object turns about an axis through the hand's middle, by 1 rad; then it is off, and tumbles.

    The hand is a ball whose fingertips are five patches; the object a long thin one that it holds at one end.
    """
    rng = np.random.default_rng(0)
    hand = ball(0.03)
    mesh = ball(0.03)
    mesh = Mesh(mesh.vertices * [1.0, 0.6, 0.6] + [0.05, 0.0, 0.0], mesh.faces)
    spin = se3.rotation_about_line(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.linspace(-0.1, 0.1, 50))
    spin[30:] = se3.rigid(se3.exp_so3(rng.normal(size=(20, 3))), np.array([0.2, 0.0, 0.0]))
    T_cam_hand = se3.rigid(se3.exp_so3(0.3 * rng.normal(size=(50, 3))), np.array([0.0, 0.0, 0.6]))
    vertices = np.tile(hand.vertices, (50, 1, 1))
    regions = {finger: np.arange(10 * n, 10 * n + 8) for n, finger in enumerate((*FINGERS, "palm_edge"))}
    track = HandTrack(vertices, hand.faces, T_cam_hand, regions)
    truth = Truth(T_cam_hand @ spin, 1.0, T_cam_hand, vertices)
    clip = small_clip(50)[0]
    return replace(clip, name=name, side=side, mesh=mesh, hand=track, truth=truth)
