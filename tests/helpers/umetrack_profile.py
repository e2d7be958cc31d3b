"""A synthetic profile of a UmeTrack hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh


def profile() -> dict[str, Any]:
    """An open ball with random hinges and weights, lengths as in a hand [mm]."""
    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=60.0)
    faces = ball.faces[~(ball.faces == 0).any(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    weights = rng.dirichlet(0.2 * np.ones(17), len(used))
    axes = rng.normal(size=(22, 3))
    return {
        "hand_model": {
            "mesh_vertices": (ball.vertices[used] + [60.0, 0.0, 0.0]).tolist(),
            "mesh_triangles": faces.reshape(-1, 3).tolist(),
            "dense_bone_weights": weights.tolist(),
            "joint_rest_positions": rng.uniform(-40, 40, (22, 3)).tolist(),
            "joint_rotation_axes": (axes / np.linalg.norm(axes, axis=1, keepdims=True)).tolist(),
            "landmark_rest_positions": rng.uniform(-80, 80, (21, 3)).tolist(),
        }
    }
