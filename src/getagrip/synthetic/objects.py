"""Procedural objects of everyday sizes: closed triangle meshes of 500 to 1400 faces, in metres, z up.

Origins are those of category CADs: vessels at the middle of the base, bottles, cans and glasses at mid-height, pans on
the handle, flat, thin and other objects in their middle. Handles and the front of kitchen machines point along +x.

Meshes are made of rings. A **loft** is a stack of rings; its last ring may lie inside the first (a vessel goes up
outside and comes down inside). A **tube** (handle, spout) replaces 2 x 2 quads of the loft, so that the surface remains
one closed manifold: a mug has genus 1. Machines are assembled from closed parts that overlap. All faces point outward.

A ``Deformation`` gives the object in the hand another shape than its category's CAD model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.warp import align_similarity

N_WAVES = 6
WAVELENGTH_RANGE_DIAMETERS = (0.8, 2.0)
"""Minimum and maximum wavelength [diameters]: long enough that the surface does not fold."""
_N_SECTION_POINTS = 8
"""Number of points of a tube's section: corners and edge middles of the 2 x 2 quads that it replaces."""
_Y = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Tube:
    """A bent bar with elliptical sections that starts, and perhaps ends, on a loft.

    Attributes:
        path: centre line [m]; its first point (and its last, unless ``capped``) selects the nearest vertex of the loft.
        side: unit direction of the sections' width, normal to the path.
        width: half widths along ``side`` [m].
        height: half heights across ``side`` [m].
        capped: True if the tube does not end on the loft.
    """

    path: Float[ndarray, "P 3"]
    side: Float[ndarray, "3"]
    width: Float[ndarray, "P"]
    height: Float[ndarray, "P"]
    capped: bool = False

    def sections(self, n: int = _N_SECTION_POINTS) -> Float[ndarray, "P n 3"]:
        """Return one ring per point of the path, counter-clockwise about the path's direction."""
        tangent = np.gradient(self.path, axis=0)
        across = np.cross(tangent, self.side)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        phi = (np.arange(n) * 2.0 * np.pi / n)[:, None]
        u, v = self.width[:, None, None] * self.side, (self.height[:, None] * across)[:, None]
        return np.asarray(self.path[:, None] + np.cos(phi) * u + np.sin(phi) * v)


def loft(rings: Float[ndarray, "R N 3"], tubes: Sequence[Tube] = ()) -> Mesh:
    """Build a closed mesh with tubes from rings, each counter-clockwise about the direction to the next.

    The first and the last ring are capped by a fan about their mean.
    """
    R, N, _ = rings.shape
    grid = np.arange(R * N).reshape(R, N)
    taken = np.zeros((R, N), dtype=bool)  # quad (i, j) lies between rings i, i + 1 and columns j, j + 1
    parts = [rings.reshape(-1, 3), rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]]
    faces = [_fan_triangles(R * N, grid[0][::-1]), _fan_triangles(R * N + 1, grid[-1])]
    for tube in tubes:
        offset = sum(len(part) for part in parts)
        ends = [_cut_hole(rings, taken, tube.path[end]) for end in ((0,) if tube.capped else (0, -1))]
        inner = tube.sections()[1 : len(tube.path) if tube.capped else -1]
        start = _align_loop(rings.reshape(-1, 3), ends[0], inner[0])
        parts.append(inner.reshape(-1, 3))
        ids = np.concatenate([start[None], offset + np.arange(inner.size // 3).reshape(-1, _N_SECTION_POINTS)])
        if tube.capped:
            parts.append(inner[-1].mean(axis=0)[None])
            faces.append(_fan_triangles(offset + inner.size // 3, ids[-1]))
        else:  # seen along the tube, the hole at its end has the opposite orientation
            ids = np.concatenate([ids, _align_loop(rings.reshape(-1, 3), ends[1][::-1], inner[-1])[None]])
        faces.append(walls(ids, np.zeros(ids.shape, dtype=bool)))
    faces.append(walls(grid, taken))
    vertices, triangles = np.concatenate(parts), np.concatenate(faces)
    used, triangles = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], triangles.reshape(-1, 3).astype(np.int64))


def torus(path: Float[ndarray, "P 3"], side: Float[ndarray, "3"], radius: float) -> Mesh:
    """Make a closed ring of round section around a closed path that is counter-clockwise about ``side``."""
    tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    across = np.cross(tangent, side)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    phi = (np.arange(_N_SECTION_POINTS) * 2.0 * np.pi / _N_SECTION_POINTS)[:, None]
    rings = path[:, None] + radius * (np.cos(phi) * side + np.sin(phi) * across[:, None])
    ids = np.arange(rings.size // 3).reshape(-1, _N_SECTION_POINTS)
    faces = walls(np.concatenate([ids, ids[:1]]))
    return Mesh(rings.reshape(-1, 3), faces)


def merge_closed_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join closed parts, which may overlap, to one mesh."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + offset for m, offset in zip(meshes, offsets[:-1], strict=True)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def walls(ids: Int[ndarray, "R N"], taken: Bool[ndarray, "R N"] | None = None) -> Int[ndarray, "F 3"]:
    """Make two triangles per quad between consecutive rings of vertex indices, except for the quads ``taken`` out."""
    taken = np.zeros(ids.shape, dtype=bool) if taken is None else taken
    a, b = ids[:-1], np.roll(ids, -1, axis=1)[:-1]
    c, d = np.roll(ids, -1, axis=1)[1:], ids[1:]
    keep = ~taken[:-1].ravel()
    lower, upper = np.stack([a, b, c], -1).reshape(-1, 3)[keep], np.stack([a, c, d], -1).reshape(-1, 3)[keep]
    return np.concatenate([lower, upper])


def _fan_triangles(pole: int, ring: Int[ndarray, "N"]) -> Int[ndarray, "N 3"]:
    """Triangles between a vertex and a ring that is counter-clockwise seen from outside."""
    return np.stack([np.full(len(ring), pole), ring, np.roll(ring, -1)], axis=-1)


def _cut_hole(rings: Float[ndarray, "R N 3"], taken: ndarray, at: Float[ndarray, "3"]) -> Int[ndarray, "8"]:
    """Take out the four quads around the vertex nearest to ``at``; return their boundary, seen from outside ccw."""
    N = rings.shape[1]
    i, j = divmod(int(np.argmin(np.linalg.norm(rings[1:-1] - at, axis=-1))), N)
    i += 1
    for di in (-1, 0):
        for dj in (-1, 0):
            taken[i + di, (j + dj) % N] = True
    around = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]
    return np.array([(i + di) * N + (j + dj) % N for di, dj in around])


def _align_loop(
    vertices: Float[ndarray, "V 3"], loop: Int[ndarray, "8"], ring: Float[ndarray, "8 3"]
) -> Int[ndarray, "8"]:
    """Rotate the loop so that it meets the ring with the least twist."""
    rolls = [np.roll(loop, k) for k in range(len(loop))]
    return min(rolls, key=lambda ids: float(np.linalg.norm(vertices[ids] - ring, axis=1).sum()))


def parse_profile(
    corners: str, across: float, along: float, right: float = 0.0, up: float = 0.0
) -> list[tuple[float, float]]:
    """Parse corners "a b, a b, ...", in units of two sizes of the object, to metres, and add ``right`` and ``up``."""
    pairs = [pair.split() for pair in corners.split(",")]
    return [(float(a) * across + right, float(b) * along + up) for a, b in pairs]


def _resample_polyline(corners: Sequence[tuple[float, float]], spacing: float) -> Float[ndarray, "P 2"]:
    """Divide the edges of a polyline evenly into pieces of at most ``spacing``."""
    p = np.asarray(corners, dtype=float)
    pieces = []
    for a, b in pairwise(p):
        n = max(int(np.ceil(np.linalg.norm(b - a) / spacing)), 1)
        pieces.append(a + (b - a) * np.arange(n)[:, None] / n)
    return np.concatenate([*pieces, p[-1:]])


def revolve_profile(
    corners: Sequence[tuple[float, float]], columns: int, spacing: float, focus: float = 0.0
) -> Float[ndarray, "R N 3"]:
    """Make the rings of a surface of revolution about z from a profile of (radius, height) corners.

    ``focus`` in [0, 1) crowds the columns towards +x, the side of a handle.
    """
    profile = _resample_polyline(corners, spacing)
    s = np.arange(columns) * 2.0 * np.pi / columns
    angle = s - focus * np.sin(s)
    r, z = profile[:, :1], profile[:, 1:]
    return np.stack(np.broadcast_arrays(r * np.cos(angle), r * np.sin(angle), z), axis=-1)


def slab(size: tuple[float, float, float], power: float, bevel: float, columns: int, layers: int) -> Mesh:
    """Make a box with rounded upright edges (superellipse) and bevelled rims, centred at the origin."""
    lx, ly, lz = (s / 2.0 for s in size)
    s = (np.arange(columns) + 0.5) * 2.0 * np.pi / columns
    c, sn = np.cos(s), np.sin(s)
    section = np.stack([np.sign(c) * np.abs(c) ** (2 / power), np.sign(sn) * np.abs(sn) ** (2 / power)], axis=-1)
    shrink = 1.0 - bevel / min(lx, ly)
    caps = np.array([0.25, 0.6]) * shrink
    heights = np.linspace(-lz + bevel, lz - bevel, layers + 1)
    factor = np.concatenate([caps, [shrink], np.ones(layers + 1), [shrink], caps[::-1]])
    z = np.concatenate([np.full(3, -lz), heights, np.full(3, lz)])
    rings = factor[:, None, None] * section * np.array([lx, ly])
    return loft(np.concatenate([rings, np.broadcast_to(z[:, None, None], (*rings.shape[:2], 1))], axis=-1))


def arc(points: Sequence[tuple[float, float]], n: int) -> Float[ndarray, "n 3"]:
    """Sample a Catmull-Rom spline through (x, z) points in the plane y = 0, at n parameters."""
    p = np.asarray(points, dtype=float)
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(p, axis=0), axis=1)))])
    slope = np.gradient(p, knots, axis=0)
    t = np.linspace(0.0, knots[-1], n)
    k = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(p) - 2)
    h = np.diff(knots)[k, None]
    u = (t - knots[k])[:, None] / h
    start = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * p[k] + u * (1.0 - u) ** 2 * h * slope[k]
    end = u**2 * (3.0 - 2.0 * u) * p[k + 1] + u**2 * (u - 1.0) * h * slope[k + 1]
    xz = start + end
    return np.stack([xz[:, 0], np.zeros(n), xz[:, 1]], axis=-1)


def handle(points: Sequence[tuple[float, float]], n: int, width: float, height: float, capped: bool = False) -> Tube:
    return Tube(arc(points, n), _Y, np.full(n, width), np.full(n, height), capped)


def _vessel_profile(
    base: float, rim: float, height: float, wall: float, belly: float = 0.0
) -> list[tuple[float, float]]:
    """Profile of an open vessel, outside, then inside; ``belly`` widens it at mid-height [m]."""
    lift = np.linspace(0.0, 1.0, 6)
    r = base + (rim - base) * lift + belly * np.sin(np.pi * lift)
    out = [(0.35 * base, 0.0), (0.9 * base, 0.0), (base, 0.04 * height)]
    out += [(float(a), float(h)) for a, h in zip(r[1:], lift[1:] * height, strict=True)]
    inner = [(float(a) - wall, float(h)) for a, h in zip(r[::-1], lift[::-1] * height, strict=True)]
    return [*out, *inner[:-1], (0.9 * (base - wall), wall + 0.03 * height), (0.35 * base, wall)]


def bottle(radius: float = 0.036, height: float = 0.22, neck: float = 0.013) -> Mesh:
    """Make a closed bottle with shoulders, a neck and a cap."""
    body = parse_profile("0.5 0, 0.92 0, 1 0.02, 1 0.56, 0.96 0.62, 0.8 0.7, 0.63 0.77", radius, height, up=-height / 2)
    top = parse_profile("1 0.83, 0.95 0.89, 1.15 0.895, 1.15 0.99, 0.5 1", neck, height, up=-height / 2)
    return loft(revolve_profile(body + top, 24, 0.013))


def ketchup(radius: float = 0.038, height: float = 0.19, flatness: float = 0.62) -> Mesh:
    """Make a flat squeeze bottle that stands on its wide cap."""
    cap = "0.3 0, 0.62 0, 0.66 0.02, 0.6 0.17, 0.66 0.19"
    body = "0.85 0.27, 0.92 0.36, 0.86 0.52, 0.95 0.68, 1 0.84, 0.92 0.95, 0.6 1, 0.25 1"
    rings = revolve_profile(parse_profile(f"{cap}, {body}", radius, height, up=-height / 2), 24, 0.014)
    upper = np.clip((rings[..., 2] / height + 0.5 - 0.15) / 0.2, 0.0, 1.0)  # 0 at the round cap
    rings[..., 1] *= 1.0 - (1.0 - flatness) * upper
    return loft(rings)


def can(radius: float = 0.034, height: float = 0.11) -> Mesh:
    """Make a closed tin with raised rims."""
    low = parse_profile("0.35 0.02, 0.7 0.02, 0.9 0.02, 0.93 0, 0.98 0, 1 0.03, 0.965 0.055", radius, height)
    profile = [*low, *((r, height - z) for r, z in low[::-1])]
    return loft(revolve_profile([(r, z - height / 2) for r, z in profile], 26, 0.011))


def jar(radius: float = 0.037, height: float = 0.105) -> Mesh:
    """Make a closed jar: a straight body, and a lid of nearly its width."""
    corners = "0.5 0, 0.92 0, 1 0.03, 1 0.7, 0.94 0.76, 0.87 0.78, 0.9 0.8, 0.9 0.98, 0.5 1"
    return loft(revolve_profile(parse_profile(corners, radius, height, up=-height / 2), 26, 0.011))


def ball(radius: float = 0.035) -> Mesh:
    """Make a ball."""
    angles = np.linspace(0.06, np.pi - 0.06, 17).tolist()
    return loft(revolve_profile([(radius * np.sin(a), -radius * np.cos(a)) for a in angles], 32, radius))


def glass(base: float = 0.029, rim: float = 0.038, height: float = 0.13, wall: float = 0.003) -> Mesh:
    """Make a tumbler, wider at the rim."""
    corners = [(r, z - height / 2) for r, z in _vessel_profile(base, rim, height, wall)]
    return loft(revolve_profile(corners, 24, 0.018))


def bowl(rim: float = 0.078, height: float = 0.07, wall: float = 0.004) -> Mesh:
    """Make a round bowl on a small foot."""
    return loft(revolve_profile(_vessel_profile(0.42 * rim, rim, height, wall, belly=0.16 * rim), 28, 0.019))


def plate(radius: float = 0.11, height: float = 0.02, wall: float = 0.004) -> Mesh:
    """Make a dinner plate with a raised rim."""
    under = parse_profile("0.25 0, 0.6 0, 0.72 0.35, 0.86 0.75, 0.985 0.95, 1 1", radius, height - wall)
    over = parse_profile("0.985 1, 0.85 0.75, 0.7 0.35, 0.58 0, 0.25 0", radius, height - wall, up=wall)
    return loft(revolve_profile(under + over, 30, 0.028))


def mug(radius: float = 0.041, height: float = 0.095, wall: float = 0.004, reach: float = 0.036) -> Mesh:
    """Make a straight mug with a D-shaped handle."""
    path = parse_profile("0 0.8, 0.75 0.82, 1 0.52, 0.65 0.24, 0 0.26", reach, height, right=radius)
    rings = revolve_profile(_vessel_profile(0.95 * radius, radius, height, wall), 24, 0.016, focus=0.25)
    return loft(rings, [handle(path, 11, 0.0065, 0.0045)])


def pitcher(radius: float = 0.06, height: float = 0.19, wall: float = 0.004, reach: float = 0.05) -> Mesh:
    """Make a water jug with a long handle and, opposite, a spout."""
    path = parse_profile("-0.02 0.87, 0.8 0.86, 1 0.55, 0.7 0.22, -0.1 0.2", reach, height, right=radius)
    rings = revolve_profile(_vessel_profile(0.85 * radius, radius, height, wall), 22, 0.028, focus=0.25)
    top = np.clip(4.0 * rings[..., 2] / height - 3.0, 0.0, 1.0)
    rings[..., 0] -= 0.3 * radius * top * np.clip(-rings[..., 0] / radius, 0.0, 1.0) ** 4
    return loft(rings, [handle(path, 12, 0.011, 0.007)])


def jug(radius: float = 0.05, height: float = 0.115, wall: float = 0.003, reach: float = 0.04) -> Mesh:
    """Make a low, round-bellied jug for milk or for measuring: a wide lip at -x, a handle at +x."""
    path = parse_profile("0.08 0.86, 0.8 0.9, 1 0.58, 0.7 0.28, 0.2 0.22", reach, height, right=radius)
    rings = revolve_profile(_vessel_profile(0.9 * radius, radius, height, wall, belly=0.1 * radius), 22, 0.016, 0.25)
    top = np.clip(4.0 * rings[..., 2] / height - 3.0, 0.0, 1.0)
    rings[..., 0] -= 0.35 * radius * top * np.clip(-rings[..., 0] / radius, 0.0, 1.0) ** 3
    return loft(rings, [handle(path, 11, 0.007, 0.005)])


def cup(radius: float = 0.044, height: float = 0.066, wall: float = 0.003, reach: float = 0.026) -> Mesh:
    """Make a round-bellied tea cup with a small ear."""
    path = parse_profile("-0.07 0.76, 0.85 0.78, 0.9 0.48, -0.17 0.36", reach, height, right=radius)
    profile = _vessel_profile(0.58 * radius, radius, height, wall, belly=0.13 * radius)
    rings = revolve_profile(profile, 24, 0.013, focus=0.3)
    return loft(rings, [handle(path, 9, 0.004, 0.0032)])


def vessel_with_handle(
    profile: Sequence[tuple[float, float]], rim: float, height: float, bar: float, rise: float
) -> Mesh:
    """Make a vessel with one straight handle of length ``bar`` along +x; the origin lies on the handle."""
    n, at = 10, 0.62 * height
    points = parse_profile("0 0, 0.25 0.45, 0.6 0.9, 1 1", bar, rise, rim, at)
    width = np.interp(np.linspace(0, 1, n), [0, 0.2, 0.45, 0.85, 1], [0.010, 0.009, 0.0125, 0.0125, 0.007])
    tube = Tube(arc(points, n), _Y, width, 0.62 * width, capped=True)
    mesh = loft(revolve_profile(profile, 30, 0.022, focus=0.55), [tube])
    grip = np.array([rim + 0.62 * bar, 0.0, at + 0.9 * rise])
    return Mesh(mesh.vertices - grip, mesh.faces)


def pan(rim: float = 0.125, height: float = 0.042, bar: float = 0.17) -> Mesh:
    """Make a frying pan."""
    return vessel_with_handle(_vessel_profile(0.78 * rim, rim, height, 0.004), rim, height, bar, 0.03)


def saucepan(rim: float = 0.085, height: float = 0.095, bar: float = 0.15) -> Mesh:
    """Make a deep pan with a straight handle."""
    return vessel_with_handle(_vessel_profile(0.96 * rim, rim, height, 0.004), rim, height, bar, 0.015)


def kettle(radius: float = 0.075, height: float = 0.15, reach: float = 0.052) -> Mesh:
    """Make a closed coffee pot: a handle at +x, a spout at -x, a knob on the lid."""
    body = "0.35 0, 0.7 0, 0.93 0, 1 0.06, 0.99 0.25, 0.9 0.5, 0.76 0.72, 0.62 0.86"
    lid = "0.6 0.88, 0.3 0.93, 0.12 0.935, 0.16 0.98, 0.09 1"
    rings = revolve_profile(parse_profile(f"{body}, {lid}", radius, height), 28, 0.021)
    bow = parse_profile("-0.34 0.74, 0.75 0.8, 1 0.55, 0.6 0.24, -0.01 0.2", reach, height, right=radius)
    spout = arc(parse_profile("-0.93 0.4, -1.25 0.55, -1.42 0.8, -1.62 0.9", radius, height), 7)
    thick = np.linspace(0.014, 0.007, 7)
    return loft(rings, [handle(bow, 12, 0.010, 0.0065), Tube(spout, _Y, thick, thick, capped=True)])


def watering_can(radius: float = 0.07, height: float = 0.13, reach: float = 0.07) -> Mesh:
    """Make a small watering can: a long spout from low at -x to above the rim, a handle from the top to the side."""
    body = "0.35 0, 0.9 0, 1 0.04, 0.98 0.3, 0.94 0.6, 0.9 0.9, 0.88 1, 0.84 1, 0.86 0.9, 0.88 0.6, 0.9 0.2, 0.35 0.06"
    rings = revolve_profile(parse_profile(body, radius, height), 24, 0.021, focus=0.2)
    bow = parse_profile("0 0.9, 0.35 1.15, 0.85 1.1, 1 0.8, 0.7 0.42, -0.05 0.28", reach, height, right=radius)
    spout = arc(parse_profile("-0.98 0.25, -1.5 0.4, -2.1 0.85, -2.75 1.22, -2.95 1.3", radius, height), 10)
    thick = np.interp(np.linspace(0.0, 1.0, 10), [0.0, 0.8, 1.0], [0.014, 0.007, 0.013])
    return loft(rings, [handle(bow, 14, 0.009, 0.0065), Tube(spout, _Y, thick, thick, capped=True)])


def french_press(radius: float = 0.046, height: float = 0.165, reach: float = 0.05) -> Mesh:
    """Make a French press: a straight beaker with a lip at -x, a lid with the plunger's knob, a handle at +x."""
    beaker = "0.35 0, 0.95 0, 1 0.03, 1 0.3, 1 0.6, 1 0.86, 1.03 0.88, 1.03 0.94"
    lid = "0.8 0.98, 0.4 1, 0.07 1.005, 0.06 1.15, 0.2 1.17, 0.24 1.2, 0.2 1.24, 0.08 1.25"
    rings = revolve_profile(parse_profile(f"{beaker}, {lid}", radius, height), 24, 0.019, focus=0.25)
    lip = np.clip(1.0 - np.abs(rings[..., 2] / height - 0.9) / 0.07, 0.0, 1.0)
    rings[..., 0] -= 0.3 * radius * lip * np.clip(-rings[..., 0] / radius, 0.0, 1.0) ** 6
    path = parse_profile("-0.02 0.84, 0.8 0.86, 1 0.62, 0.95 0.3, 0.7 0.12, -0.02 0.1", reach, height, right=radius)
    return loft(rings, [handle(path, 13, 0.009, 0.0065)])


def spray_bottle(radius: float = 0.038, height: float = 0.24) -> Mesh:
    """Make a spray bottle: a body with a slim neck, a head whose nozzle points to +x, a lever below it."""
    body = "0.35 0, 0.92 0, 1 0.02, 1 0.2, 1 0.4, 0.95 0.5, 0.72 0.6, 0.42 0.68, 0.36 0.74, 0.4 0.86, 0.2 0.87"
    rings = revolve_profile(parse_profile(body, radius, height), 20, 0.022)
    rings[..., 1] *= 0.8
    z = 0.86 * height
    head = _rounded_block((-0.035, -0.014, z - 0.004), (0.055, 0.014, z + 0.14 * height), 4.0)
    lever = _bent_bar([(0.026, z + 0.005), (0.034, z - 0.02), (0.03, z - 0.045), (0.04, z - 0.065)], 8, 0.009, 0.004)
    return merge_closed_meshes([loft(rings), head, lever])


def box(size: tuple[float, float, float] = (0.062, 0.12, 0.17)) -> Mesh:
    """Make a carton."""
    return slab(size, 14.0, 0.0015, 32, 9)


def phone(size: tuple[float, float, float] = (0.074, 0.15, 0.0095)) -> Mesh:
    """Make a phone, screen up."""
    return slab(size, 9.0, 0.002, 48, 2)


def remote(size: tuple[float, float, float] = (0.046, 0.17, 0.02)) -> Mesh:
    """Make a remote control, keys up."""
    return slab(size, 6.0, 0.003, 40, 3)


def book(size: tuple[float, float, float] = (0.13, 0.19, 0.02)) -> Mesh:
    """Make a closed book."""
    return slab(size, 14.0, 0.0015, 48, 2)


def laptop(size: tuple[float, float, float] = (0.24, 0.30, 0.02)) -> Mesh:
    """Make a closed laptop."""
    return slab(size, 12.0, 0.004, 48, 2)


def spoon(length: float = 0.19, width: float = 0.046) -> Mesh:
    """Make a table spoon, its bowl at +x."""
    s = np.linspace(0.0, 1.0, 26)
    x = length * (s - 0.5)
    section = [0.07, 0.13, 0.16, 0.17, 0.13, 0.09, 0.08, 0.10, 0.30, 0.45, 0.5, 0.46, 0.34, 0.12]
    places = [0.0, 0.02, 0.06, 0.12, 0.3, 0.5, 0.6, 0.66, 0.73, 0.80, 0.87, 0.94, 0.98, 1.0]
    half = width * np.interp(s, places, section)
    hollow = 0.26 * width * np.interp(s, [0.66, 0.80, 0.92, 1.0], [0.0, 1.0, 0.9, 0.25])
    bend = 0.07 * length * (np.cos(np.pi * np.clip(s / 0.75, 0, 1)) * 0.5 + 0.5) - hollow
    phi = np.arange(16) * np.pi / 8.0
    y = half[:, None] * np.cos(phi)
    z = bend[:, None] + hollow[:, None] * np.cos(phi) ** 2 + 0.0014 * np.sin(phi)
    return loft(np.stack([np.broadcast_to(x[:, None], y.shape), y, z], axis=-1))


def knife(length: float = 0.3, depth: float = 0.042) -> Mesh:
    """Make a kitchen knife, its blade at +x, the edge down."""
    s = np.linspace(0.0, 1.0, 24)
    low = depth * np.interp(s, [0.0, 0.05, 0.36, 0.4, 0.7, 0.9, 1.0], [-0.3, -0.5, -0.4, -0.9, -0.8, -0.4, 0.0])
    high = depth * np.interp(s, [0.0, 0.05, 0.4, 0.8, 1.0], [0.0, 0.12, 0.1, 0.1, 0.03])
    thick = np.interp(s, [0.0, 0.05, 0.38, 0.4, 1.0], [0.006, 0.01, 0.009, 0.0015, 0.001])
    path = np.stack([length * (s - 0.5), np.zeros(24), (low + high) / 2.0], axis=-1)
    return loft(Tube(path, _Y, thick, (high - low) / 2.0, capped=True).sections(16))


def screwdriver(radius: float = 0.016, length: float = 0.22) -> Mesh:
    """Make a screwdriver, its tip up."""
    corners = "0.4 0, 0.85 0.01, 1 0.08, 0.85 0.25, 1 0.4, 0.6 0.45, 0.2 0.46, 0.2 0.8, 0.2 0.98, 0.1 1"
    return loft(revolve_profile(parse_profile(corners, radius, length, up=-length / 2), 20, 0.009))


def hammer(length: float = 0.3, width: float = 0.12) -> Mesh:
    """Make a hammer, its head up, the face at +x and the peen at -x."""
    grip = "0.4 0, 0.9 0.01, 1 0.1, 0.8 0.35, 0.6 0.5, 0.6 0.93, 0.3 0.95"
    profile = parse_profile(grip, 0.017, length, up=-length / 2)
    x, half = np.array([-0.55, -0.5, -0.2, 0.15, 0.2, 0.45, 0.47]), np.array([0.15, 0.25, 0.8, 0.8, 0.9, 0.9, 0.5])
    path = np.stack([width * x, np.zeros(7), np.full(7, 0.42 * length)], axis=-1)
    head = loft(Tube(path, _Y, 0.016 * np.maximum(half, 0.6), 0.016 * half, capped=True).sections(16))
    return merge_closed_meshes([loft(revolve_profile(profile, 18, 0.018)), head])


def scissors(length: float = 0.19, spread: float = 0.30) -> Mesh:
    """Make slightly open scissors, blades towards +x.

    Two crossing blades and two finger rings, ``spread`` in radians.
    """
    halves = []
    n = 14
    s = np.linspace(0.0, 1.0, n)
    for sign in (1.0, -1.0):
        x = length * (s - 0.42)
        away = -sign * (np.tan(spread / 2.0) * x - 0.05 * length * np.clip(0.28 - s, 0.0, 1.0) / 0.28)
        path = np.stack([x, away, np.full(n, sign * 0.0013)], axis=-1)
        half = length * np.interp(s, [0.0, 0.25, 0.42, 0.55, 1.0], [0.024, 0.026, 0.042, 0.044, 0.006])
        blade = Tube(path, np.array([0.0, 0.0, 1.0]), np.where(s < 0.3, 0.0034, 0.0014), half, capped=True)
        halves.append(loft(blade.sections()))
        phi = np.arange(20) * np.pi / 10.0
        centre = path[0] + length * np.array([-0.115, 0.02 * sign, 0.0])
        ring = centre + length * np.stack([0.125 * np.cos(phi), 0.085 * np.sin(phi), np.zeros(20)], axis=-1)
        halves.append(torus(ring, np.array([0.0, 0.0, 1.0]), 0.0048))
    return merge_closed_meshes(halves)


def tape(radius: float = 0.049, core: float = 0.0415, width: float = 0.048) -> Mesh:
    """Make a roll of packing tape."""
    z = width / 2.0
    corners = [(core, -z), (radius, -z), (radius, z), (core, z), (core, -z)]
    rings = revolve_profile(corners, 32, 0.012)[:-1]
    ids = np.arange(rings.size // 3).reshape(rings.shape[:2])
    return Mesh(rings.reshape(-1, 3), walls(np.concatenate([ids, ids[:1]])))


def banana(length: float = 0.18, thickness: float = 0.034) -> Mesh:
    """Make a banana, its ends up."""
    path = arc(parse_profile("-0.5 0.25, -0.44 0.15, -0.25 0.04, 0 0, 0.25 0.04, 0.44 0.18", length, length), 34)
    along, radii = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0], [0.3, 0.35, 0.85, 1.0, 0.85, 0.25]
    half = thickness / 2.0 * np.interp(np.linspace(0.0, 1.0, 34), along, radii)
    return loft(Tube(path, _Y, half, half, capped=True).sections())


def umbrella(radius: float = 0.031, length: float = 0.27) -> Mesh:
    """Make a folded umbrella, its handle up."""
    cloth = "0.3 0, 0.65 0, 0.84 0.06, 0.94 0.2, 0.87 0.5, 0.9 0.69, 1 0.82"
    corners = parse_profile(f"{cloth}, 0.62 0.835, 0.62 0.98, 0.55 1, 0.2 1", radius, length, up=-length / 2)
    return loft(revolve_profile(corners, 24, 0.016))


def _rounded_block(
    low: tuple[float, float, float], high: tuple[float, float, float], power: float = 7.0, layers: int = 2
) -> Mesh:
    size = np.subtract(high, low)
    part = slab((float(size[0]), float(size[1]), float(size[2])), power, 0.004, 18, layers)
    return Mesh(part.vertices + (np.array(low) + high) / 2.0, part.faces)


def _bent_bar(points: Sequence[tuple[float, float]], n: int, width: float, height: float) -> Mesh:
    """Make a bent bar of elliptical section through (x, z) points, closed at both ends."""
    return loft(handle(points, n, width, height).sections(12))


def notebook(size: tuple[float, float, float] = (0.15, 0.21, 0.014)) -> Mesh:
    """Make a closed notebook."""
    return slab(size, 24.0, 0.001, 48, 2)


def waffle_iron(radius: float = 0.095, height: float = 0.08, bar: float = 0.12) -> Mesh:
    """Make a round, closed waffle iron with a straight handle; the origin lies on the handle."""
    low = parse_profile("0.35 0, 0.7 0, 0.93 0.02, 1 0.14, 1 0.3, 1 0.44, 0.97 0.48", radius, height)
    return vessel_with_handle([*low, *((r, height - z) for r, z in low[::-1])], radius, height, bar, 0.006)


def mixer(length: float = 0.19, width: float = 0.075, height: float = 0.075) -> Mesh:
    """Make a hand mixer: a body along x, a handle above it, two beaters below its front."""
    s = np.linspace(0.0, 1.0, 12)
    full = np.interp(s, [0.0, 0.05, 0.2, 0.8, 0.95, 1.0], [0.35, 0.75, 1.0, 1.0, 0.7, 0.3]) / 2.0
    phi = np.arange(24) * np.pi / 12.0
    section = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    section = np.sign(section) * np.abs(section) ** 0.75
    x = np.broadcast_to((length * (s - 0.5))[:, None], (12, 24))
    rings = np.stack([x, *np.moveaxis(full[:, None, None] * section * [width, height], -1, 0)], axis=-1)
    bow = [(-0.36 * length, 0.46 * height), (-0.40 * length, 0.86 * height), (0.0, 1.12 * height)]
    bow += [(0.34 * length, 0.98 * height), (0.36 * length, 0.46 * height)]
    profile = parse_profile("0.12 0, 0.6 0.06, 1 0.25, 0.75 0.42, 0.2 0.5, 0.18 0.8, 0.18 1, 0.05 1", 0.019, 0.13)
    beater = loft(revolve_profile(profile, 10, 0.02))
    places = np.array([0.22 * length, 0.021, -0.13 - 0.3 * height]) * [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]
    beaters = (Mesh(beater.vertices + at, beater.faces) for at in places)
    return merge_closed_meshes([loft(rings, [handle(bow, 12, 0.014, 0.011)]), *beaters])


def espresso_machine(width: float = 0.105, height: float = 0.22) -> Mesh:
    """Make a small espresso machine: base, column and head, the filter's handle in front."""
    y, z = width / 2.0, height / 2.0
    base = _rounded_block((-0.085, -y, -z), (0.085, y, -z + 0.035))
    column = _rounded_block((-0.085, -0.8 * y, -z + 0.02), (-0.025, 0.8 * y, z - 0.03), layers=5)
    head = _rounded_block((-0.09, -y, z - 0.075), (0.07, y, z))
    bar = [(0.03, z - 0.085), (0.08, z - 0.088), (0.13, z - 0.095), (0.18, z - 0.10)]
    return merge_closed_meshes([base, column, head, _bent_bar(bar, 9, 0.014, 0.013)])


def capsule_machine(width: float = 0.085, height: float = 0.20) -> Mesh:
    """Make a narrow capsule machine: tray, column and rounded head, a lever above."""
    y, z = width / 2.0, height / 2.0
    tray = _rounded_block((-0.06, -y, -z), (0.11, y, -z + 0.025))
    column = _rounded_block((-0.07, -0.85 * y, -z + 0.01), (0.01, 0.85 * y, z - 0.03), 5.0, 5)
    head = _rounded_block((-0.075, -0.8 * y, z - 0.07), (0.10, 0.8 * y, z), 4.0)
    lever = [(-0.05, z - 0.01), (-0.045, z + 0.018), (0.0, z + 0.024), (0.05, z + 0.018), (0.085, z + 0.012)]
    return merge_closed_meshes([tray, column, head, _bent_bar(lever, 10, 0.012, 0.005)])


def microwave(size: tuple[float, float, float] = (0.17, 0.26, 0.15)) -> Mesh:
    """Make a small microwave oven with a bow handle at the edge of its door."""
    depth, width, height = size
    x, z = depth / 2.0, height / 2.0
    body = slab(size, 12.0, 0.005, 40, 5)
    bow = [(x - 0.01, 0.8 * z), (x + 0.052, 0.76 * z), (x + 0.066, 0.0), (x + 0.052, -0.76 * z), (x - 0.01, -0.8 * z)]
    grip = _bent_bar(bow, 16, 0.010, 0.009)
    return merge_closed_meshes([body, Mesh(grip.vertices + np.array([0.0, 0.3 * width, 0.0]), grip.faces)])


@dataclass(frozen=True)
class Deformation:
    """A displacement of points by a few sine waves.

    Attributes:
        waves: (W, 3) wave vectors [rad/m].
        phase: (W,) phases [rad].
        amplitude: (W, 3) displacements [m].
    """

    waves: Float[ndarray, "W 3"]
    phase: Float[ndarray, "W"]
    amplitude: Float[ndarray, "W 3"]

    def __call__(self, X: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Return the deformed points [m]."""
        return X + np.sin(X @ self.waves.T + self.phase) @ self.amplitude


def draw_deformation(mesh: Mesh, share: float, rng: np.random.Generator) -> Deformation:
    """Draw a random deformation by ``share`` of the mesh's diameter: root mean square after the best similarity."""
    waves = rng.normal(size=(N_WAVES, 3))
    wavelength = mesh.diameter * rng.uniform(*WAVELENGTH_RANGE_DIAMETERS, (N_WAVES, 1))
    waves *= 2.0 * np.pi / (wavelength * np.linalg.norm(waves, axis=1)[:, None])
    phase = rng.uniform(0.0, 2.0 * np.pi, N_WAVES)
    unit = Deformation(waves, phase, 1e-3 * mesh.diameter * rng.normal(size=(N_WAVES, 3)))
    deformed = Mesh(unit(mesh.vertices), mesh.faces)
    return replace(unit, amplitude=unit.amplitude * share * mesh.diameter / misfit(mesh, deformed))


def misfit(cad: Mesh, grasped: Mesh) -> float:
    """Compute the root mean square distance of corresponding surface points after the best similarity [m]."""
    T, size = align_similarity(cad, grasped, resize=True)
    off = np.sum((se3.transform(T, size * cad.vertices) - grasped.vertices) ** 2, axis=1)
    return float(np.sqrt(grasped.vertex_areas @ off / grasped.vertex_areas.sum()))
