"""Polygons cut into triangles: fans where they are convex, ears where not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

MOST_CORNERS = 2000
"""Of a polygon that is cut by ears, whose time grows with their square; larger ones are cut into fans."""


def triangulated(points: Float[ndarray, "N 3"]) -> list[tuple[int, int, int]]:
    """N - 2 triangles of a simple polygon, by the indices of its corners, turning as it turns.

    Ears are cut in the polygon's plane, whose normal is Newell's. A polygon that has none left, as one that crosses
    itself, is cut into a fan from there on.
    """
    count = len(points)
    fan = [(0, n, n + 1) for n in range(1, count - 1)]
    if count < 4 or not np.isfinite(points).all():
        return fan
    flat = _in_plane(points)
    if flat is None or count > MOST_CORNERS or _is_convex(flat):
        return fan
    left, triangles = list(range(count)), []
    while len(left) > 3:
        ear = _ear(flat[left])
        if ear is None:
            break
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return triangles + [(left[0], b, c) for b, c in pairwise(left[1:])]


def _in_plane(points: Float[ndarray, "N 3"]) -> Float[ndarray, "N 2"] | None:
    """The corners in the polygon's plane, counter-clockwise; None where it has no area."""
    off = points - points.mean(axis=0)
    normal = np.cross(off, np.roll(off, -1, axis=0)).sum(axis=0)
    length, extent = float(np.linalg.norm(normal)), float(np.abs(off).max())
    if length <= 1e-12 * extent**2:
        return None
    normal = normal / length
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across = across / np.linalg.norm(across)
    return np.stack([off @ across, off @ np.cross(normal, across)], axis=1) / extent


def _turns(a: Float[ndarray, "N 2"], b: Float[ndarray, "N 2"], c: Float[ndarray, "N 2"]) -> Float[ndarray, "N"]:
    """Twice the signed areas of triangles, positive where they are counter-clockwise."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


def _is_convex(flat: Float[ndarray, "N 2"]) -> bool:
    """Whether no corner turns back; a polygon that winds twice is not asked for."""
    return bool((_turns(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0)) >= -1e-12).all())


def _ear(flat: Float[ndarray, "N 2"]) -> int | None:
    """The first corner that can be cut off: a convex one whose triangle holds no other corner."""
    before, after = np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0)
    turn = _turns(before, flat, after)
    reflex = flat[turn <= 0]
    for n in np.flatnonzero(turn > 1e-14):
        a, b, c = before[n], flat[n], after[n]
        inside = (_turns(a, b, reflex) >= 0) & (_turns(b, c, reflex) >= 0) & (_turns(c, a, reflex) >= 0)
        corner = (reflex == a).all(axis=1) | (reflex == b).all(axis=1) | (reflex == c).all(axis=1)
        if not (inside & ~corner).any():
            return int(n)
    return None
