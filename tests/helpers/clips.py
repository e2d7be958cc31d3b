"""A box, and a small valid clip that holds one."""

from __future__ import annotations

import numpy as np

from getagrip.clip import FINGERS, Clip, HandTrack, Masks, Truth
from getagrip.geometry.mesh import Mesh

BOX_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def box(x: float, y: float, z: float) -> Mesh:
    """A box about the origin, its faces outward."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    return Mesh(corners * [x, y, z], BOX_FACES)


def small_clip(frames: int = 3, seed: int = 0) -> tuple[Clip, Masks]:
    """A valid clip of almost nothing: a box for an object, a box with five fingertips for a hand."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3, 3] = [0.0, 0.0, 0.5] + 0.01 * rng.standard_normal((frames, 3))
    hand = HandTrack(
        vertices=box(0.2, 0.1, 0.03).vertices + 0.001 * rng.standard_normal((frames, 8, 3)),
        faces=BOX_FACES,
        T_cam_hand=T,
        regions={name: np.array([n, n + 1]) for n, name in enumerate((*FINGERS, "palm_edge"))},
        joints=0.1 * rng.standard_normal((frames, 21, 3)),
    )
    seen = np.zeros((frames, 24, 32), dtype=bool)
    seen[:, 8:16, 10:20] = True
    ignore = np.roll(seen, 6, axis=2) & ~seen
    clip = Clip(
        name="small",
        category="box",
        side="right",
        fps=30.0,
        frames=tuple(f"{n:04d}" for n in range(frames)),
        size=(32, 24),
        K=np.tile([[40.0, 0.0, 16.0], [0.0, 41.0, 12.0], [0.0, 0.0, 1.0]], (frames, 1, 1)),
        mesh=box(0.05, 0.07, 0.11),
        scale="known",
        hand=hand,
        truth=Truth(T_cam_obj=T, scale=1.0, T_cam_hand=hand.T_cam_hand, hand_vertices=hand.vertices),
        provenance={"hands": "synthetic"},
    )
    return clip, Masks(seen, ignore)
