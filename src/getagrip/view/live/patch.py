"""The part of a surface on which something is below a limit, as a mesh of its own that lies just above it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import vertex_normals

ABOVE = 4e-4
"""The patch lies so far above the surface, lest the two flicker [m]."""
NOTHING = np.zeros((3, 3)), np.array([[0, 1, 2]])
"""An empty patch: one triangle without area, for viewers that know no mesh without one."""


def patch(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], value: Float[ndarray, "V"], limit: float
) -> tuple[Float[ndarray, "W 3"], Int[ndarray, "G 3"]]:
    """Where the value, linear over each triangle, is at most ``limit``; triangles on the border are cut along it."""
    inside = value <= limit
    count = inside[faces].sum(axis=1)
    if not count.any():
        return NOTHING
    above = vertices + ABOVE * vertex_normals(vertices, faces)
    whole = faces[count == 3]
    parts, corners = [above], [whole]
    total = len(vertices)
    for kept in (1, 2):  # corners inside; roll the odd one out to the front
        cut = faces[count == kept]
        odd = np.argmax(inside[cut] == (kept == 1), axis=1)
        a, b, c = np.take_along_axis(cut, (odd[:, None] + np.arange(3)) % 3, axis=1).T
        ab, ac = _crossing(above, value, limit, a, b), _crossing(above, value, limit, a, c)
        i, j = total + np.arange(len(cut)), total + len(cut) + np.arange(len(cut))
        if kept == 1:
            corners.append(np.stack([a, i, j], axis=1))
        else:
            corners += [np.stack([i, b, c], axis=1), np.stack([i, c, j], axis=1)]
        parts += [ab, ac]
        total += 2 * len(cut)
    points, triangles = np.concatenate(parts), np.concatenate(corners)
    used, of = np.unique(triangles, return_inverse=True)
    return points[used], of.reshape(-1, 3)


def _crossing(
    points: Float[ndarray, "V 3"],
    value: Float[ndarray, "V"],
    limit: float,
    a: Int[ndarray, "n"],
    b: Int[ndarray, "n"],
) -> Float[ndarray, "n 3"]:
    """Where the value passes the limit, on edges from one side of it to the other."""
    share = (limit - value[a]) / (value[b] - value[a])
    return np.asarray(points[a] + share[:, None] * (points[b] - points[a]))
