"""The skin of the generic hand: a smooth implicit surface around its bones, and its triangulation.

The surface is the zero level of a smooth union (polynomial smooth minimum: I. Quilez, "Smooth minimum", 2013) of round
cones and ellipsoids. ``python scripts/generic_surface.py`` triangulates it and writes ``generic_hand.npz``, the file
that ``hands.generic.load`` reads; the result depends on nothing but the sources here.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.hands.generic import GENERIC_HAND_FILE, MANO_WRIST_M, metacarpal_base, rest_fingers

GRID = 0.0016
"""Cell size of the first triangulation [m]."""
VERTICES = 950
"""Number of vertices; a closed surface without holes has twice as many faces, less four."""
NORMAL_WEIGHT = 0.008
"""Weight of normals when patches are formed [m]."""
FINER = 1.6
"""Factor by which edges are shorter at the fingertips."""
WRIST_CUT = 0.010
"""Length of the hand behind the wrist joint [m]."""

WAIST = 0.05
"""Relative reduction of the bones' thickness at their middle."""

BACK = np.array([0.0, 1.0, 0.0])


def distance(X: Float[ndarray, "N 3"]) -> Float[ndarray, "N"]:
    """Approximate signed distance [m] to the skin of the flat right hand; negative inside."""
    hand = _palm(X)
    fingers = rest_fingers()
    for name, finger in fingers.items():
        flesh = np.full(len(X), np.inf)
        for k in range(3):
            part = _round_cone(
                X,
                finger.points[k : k + 2],
                finger.axes[k],
                finger.breadth[k : k + 2],
                finger.depth[k : k + 2],
                tip=k == 2,
            )
            flesh = _smooth_min(flesh, part, 0.003)
        pad = finger.points[2] + 0.62 * (finger.points[3] - finger.points[2]) - 0.0022 * finger.axes[2, 2]
        size = np.array([0.42 * np.linalg.norm(finger.points[3] - finger.points[2]), 0.86 * finger.breadth[3], 0.0055])
        flesh = _smooth_min(flesh, _ellipsoid(X, pad, finger.axes[2], size), 0.004)
        hand = _smooth_min(hand, flesh, 0.016 if name == "thumb" else 0.007)
    beyond = X[:, 0] - (MANO_WRIST_M[0] + WRIST_CUT)
    return -_smooth_min(-hand, -beyond, 0.004)


def _palm(X: Float[ndarray, "N 3"]) -> Float[ndarray, "N"]:
    fingers = rest_fingers()
    palm = np.full(len(X), np.inf)
    for name in ("index", "middle", "ring", "pinky"):
        base, knuckle = metacarpal_base(name), fingers[name].points[0]
        ends = np.array([base - 0.004 * BACK, knuckle - 0.0025 * BACK])
        palm = _smooth_min(
            palm, _round_cone(X, ends, _axes(ends), np.array([0.0115, 0.0112]), np.array([0.0150, 0.0125])), 0.010
        )
    thumb = fingers["thumb"]
    # The ball of the thumb and the edge of the hand: the muscles of thumb and little finger.
    ball = 0.45 * thumb.points[0] + 0.55 * thumb.points[1] + np.array([0.006, -0.002, -0.008])
    palm = _smooth_min(palm, _ellipsoid(X, ball, thumb.axes[0], np.array([0.027, 0.015, 0.0135])), 0.010)
    edge = np.array([[0.080, -0.010, -0.012], [0.040, -0.0085, -0.027]])
    palm = _smooth_min(
        palm, _round_cone(X, edge, _axes(edge), np.array([0.0115, 0.0105]), np.array([0.011, 0.0095])), 0.010
    )
    # The fold between thumb and index finger.
    fold = np.array([0.5 * (thumb.points[0] + thumb.points[1]), fingers["index"].points[0] + [0.020, -0.008, -0.002]])
    palm = _smooth_min(
        palm, _round_cone(X, fold, _axes(fold), np.array([0.009, 0.009]), np.array([0.0075, 0.0075])), 0.014
    )
    wrist = MANO_WRIST_M + np.array([[0.03, -0.003, -0.002], [-0.012, -0.004, -0.001]])
    return _smooth_min(
        palm, _round_cone(X, wrist, _axes(wrist), np.array([0.0285, 0.0275]), np.array([0.0190, 0.0175])), 0.012
    )


def _axes(ends: Float[ndarray, "2 3"]) -> Float[ndarray, "3 3"]:
    """Return directions along a segment, across it, and towards the back of the hand."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.cross(BACK, along)
    across /= np.linalg.norm(across)
    return np.array([along, across, np.cross(along, across)])


def _round_cone(
    X: Float[ndarray, "N 3"],
    ends: Float[ndarray, "2 3"],
    axes: Float[ndarray, "3 3"],
    breadth: Float[ndarray, "2"],
    depth: Float[ndarray, "2"],
    tip: bool = False,
) -> Float[ndarray, "N"]:
    """Compute the distance to a round cone of elliptic section, which ends at (``tip``) or around the second point."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    local = (X - ends[0]) @ axes.T
    reach = length - breadth[1] if tip else length
    t = np.clip(local[:, 0] / reach, 0.0, 1.0)
    waist = 1.0 - WAIST * np.sin(np.pi * t) ** 2
    b, d = (waist * (r[0] + t * (r[1] - r[0])) for r in (breadth, depth))
    off = np.stack([local[:, 0] - t * reach, local[:, 1], local[:, 2] * b / d], axis=-1)
    radius = np.linalg.norm(off, axis=-1)
    # In the squeezed space the distance along the depth is too large by b / d; give it back in proportion.
    squeeze = np.sqrt(off[:, 0] ** 2 + local[:, 1] ** 2 + local[:, 2] ** 2) / np.maximum(radius, 1e-12)
    return (radius - b) * np.where(radius > 1e-9, squeeze, 1.0)


def _ellipsoid(
    X: Float[ndarray, "N 3"], centre: Float[ndarray, "3"], axes: Float[ndarray, "3 3"], size: Float[ndarray, "3"]
) -> Float[ndarray, "N"]:
    local = (X - centre) @ axes.T
    k0 = np.linalg.norm(local / size, axis=-1)
    k1 = np.linalg.norm(local / size**2, axis=-1)
    return k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)


def _smooth_min(a: Float[ndarray, "N"], b: Float[ndarray, "N"], k: float) -> Float[ndarray, "N"]:
    """Return the minimum of a and b, rounded where they differ by less than k."""
    h = np.maximum(k - np.abs(np.where(np.isinf(a), 1e3, a) - b), 0.0) / k
    return np.minimum(a, b) - h * h * k / 4.0


def triangulate() -> Mesh:
    """Build the mesh of the surface: marching cubes, then the dual of evenly grown patches of it.

    The patches are the cells of Lloyd's algorithm on the points of the fine mesh (Valette, Chassery, "Approximated
    Centroidal Voronoi Diagrams for Uniform Polygonal Mesh Coarsening", 2004), whose density goes with the square root
    of the weight. Normals count as well, so that thin parts keep both their sides.
    """
    import igl

    low, high = np.array([-0.100, -0.056, -0.072]), np.array([0.114, 0.036, 0.110])
    counts = np.ceil((high - low) / GRID).astype(int) + 1
    z, y, x = (low[k] + GRID * np.arange(counts[k]) for k in (2, 1, 0))
    grid = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1).reshape(-1, 3)  # x fastest, as libigl wants it
    fine, triangles = igl.marching_cubes(distance(grid), grid, *(int(n) for n in counts), 0.0)[:2]
    normals = gradient(fine)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    features, weight = np.concatenate([fine, NORMAL_WEIGHT * normals], axis=1), fineness(fine) ** 4
    for seed in range(20):  # a start may end with a patch that is not a disc, whose dual is not closed
        patch = _patches(features, weight, seed)
        vertices = project(_means(fine, patch, weight))
        for finger in rest_fingers().values():
            vertices[np.argmin(np.linalg.norm(vertices - finger.points[3], axis=1))] = project(finger.points[3:])[0]
        mesh = _dual(vertices, patch[triangles])
        if mesh.is_closed and len(mesh.faces) == 2 * VERTICES - 4:
            return mesh
    raise RuntimeError("no start gave a closed mesh; change VERTICES")


def _patches(features: Float[ndarray, "N 6"], weight: Float[ndarray, "N"], seed: int) -> Int[ndarray, "N"]:
    """Assign each point to a patch: Lloyd's algorithm from random points."""
    from scipy.spatial import cKDTree

    share = np.sqrt(weight) / np.sqrt(weight).sum()
    centres = features[np.random.default_rng(seed).choice(len(features), VERTICES, replace=False, p=share)]
    for _ in range(60):
        patch = cKDTree(centres).query(features)[1]
        centres = _means(features, patch, weight)
    return np.asarray(patch)


def _means(
    points: Float[ndarray, "N d"], patch: Int[ndarray, "N"], weight: Float[ndarray, "N"]
) -> Float[ndarray, "V d"]:
    """Compute the weighted mean of the points of each patch."""
    sums = np.stack([np.bincount(patch, column * weight) for column in points.T], axis=1)
    return sums / np.bincount(patch, weight)[:, None]


def _dual(vertices: Float[ndarray, "V 3"], corners: Int[ndarray, "F 3"]) -> Mesh:
    """Make a face for every three patches that meet, wound outward."""
    faces = corners[np.all(corners != np.roll(corners, 1, axis=1), axis=1)]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    mesh = Mesh(vertices, faces)
    return mesh if mesh.volume > 0 else Mesh(vertices, faces[:, ::-1].copy())


def fineness(X: Float[ndarray, "N 3"]) -> Float[ndarray, "N"]:
    """Return the factor by which edges are shorter at some points: 1, but ``FINER`` at the last phalanges."""
    near = np.zeros(len(X))
    for finger in rest_fingers().values():
        arm = X - (0.4 * finger.points[2] + 0.6 * finger.points[3])
        near = np.maximum(near, np.exp(-np.sum(arm**2, axis=1) / 0.018**2))
    return 1.0 + (FINER - 1.0) * near


def gradient(X: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    """Compute the gradient of ``distance``, by central differences."""
    h = 1e-5 * np.eye(3)
    return np.stack([distance(X + e) - distance(X - e) for e in h], axis=-1) / 2e-5


def project(X: Float[ndarray, "N 3"], steps: int = 3) -> Float[ndarray, "N 3"]:
    """Move points onto the surface by Newton steps along the gradient."""
    for _ in range(steps):
        g = gradient(X)
        X = X - (distance(X) / np.sum(g * g, axis=1))[:, None] * g
    return X


if __name__ == "__main__":
    mesh = triangulate()
    np.savez_compressed(GENERIC_HAND_FILE, vertices=mesh.vertices.astype(np.float32), faces=mesh.faces.astype(np.int16))
    print(f"{GENERIC_HAND_FILE.name}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces, closed: {mesh.is_closed}")
