"""The rotations that map an object onto itself, found from its surface; reflections are excluded.

A rotation T is a symmetry if points sampled evenly over the surface, rotated by T, lie on the surface: on average at
most ``MAX_MEAN_SYMMETRY_DISTANCE`` and nowhere more than ``MAX_SYMMETRY_DISTANCE`` away. The second bound detects a
handle or a spout, a few per cent of the area. Candidates are rotations about the principal axes of the surface (and
about more axes where these are not unique), each refined by a few steps of point-to-plane ICP.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate, face_areas

MAX_MEAN_SYMMETRY_DISTANCE, MAX_SYMMETRY_DISTANCE = 0.015, 0.06
"""Maximum mean and maximum distance between the rotated and the original surface [diameters]."""
ROTATION_ORDERS = (2, 3, 4, 5, 6)
"""Tried orders of discrete rotations: 180, 120, 90, 72 and 60 degrees."""
CONTINUOUS_AXIS_ANGLES_RAD = np.radians([17.0, 40.0, 73.0, 101.0, 139.0, 180.0])
"""Rotations that are all symmetries about a continuous axis [rad]."""
AXIS_MOMENT_RATIO = 1.25
"""Ratio of second moments up to which principal axes are not unique."""
DUPLICATE_SYMMETRY_ANGLE_RAD = np.radians(10.0)
"""Angle below which rotations are one symmetry, and maximum correction of a candidate [rad]."""
N_SYMMETRY_POINTS, MAX_SYMMETRY_FACES = 600, 2000
"""Number of rotated points, and maximum number of faces of the mesh to which they are compared."""


@dataclass(frozen=True)
class Symmetries:
    """All symmetries of an object: ``about(angles) @ elements[i]``, maps of its own frame (before scaling).

    Attributes:
        elements: (S, 4, 4) discrete rotations, first the identity.
        axes: (k, 3) unit axes of continuous rotations: none, one, or three for a ball.
        centre: (3,) a point on all axes [m].
    """

    elements: Float[ndarray, "S 4 4"]
    axes: Float[ndarray, "k 3"]
    centre: Float[ndarray, "3"]

    def about(self, angles: Float[ndarray, "*batch k"]) -> Float[ndarray, "*batch 4 4"]:
        """Return the continuous rotation by the rotation vector ``angles`` [rad] in the axes' span."""
        R = se3.exp_so3(angles @ self.axes)
        return se3.rigid(R, self.centre - R @ self.centre)

    def describe(self) -> str:
        """Describe the symmetries in words, for tables."""
        if len(self.axes) == 3:
            return "ball"
        if len(self.axes) == 1:
            return "continuous" if len(self.elements) == 1 else "continuous, flips"
        rotations = np.degrees(se3.angle_between(np.eye(3), self.elements[1:, :3, :3]))
        return "none" if not rotations.size else ", ".join(f"{t:.0f}" for t in sorted(rotations.round())) + " degrees"


def find_symmetries(mesh: Mesh) -> Symmetries:
    """Find the symmetries of a mesh, at least the identity; cached, since clips share meshes."""
    return _cached_symmetries(mesh.vertices.tobytes(), mesh.faces.tobytes())


@lru_cache(maxsize=32)
def _cached_symmetries(vertices: bytes, faces: bytes) -> Symmetries:
    mesh = Mesh(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3))
    surface = _SymmetrySurface(decimate(mesh, MAX_SYMMETRY_FACES))
    centre, second_moment = _moments(mesh)
    moments, axes = np.linalg.eigh(second_moment)
    lines = _candidate_axes(moments, axes.T)

    halves = surface.promising(_rotations(centre, lines, np.pi))
    first: tuple[ndarray, ndarray] | None = None
    for half in halves:
        if (symmetry := surface.refined(half)) is None or (line := _continuous_axis(surface, centre, symmetry)) is None:
            continue
        first = first or line
        if abs(line[1] @ first[1]) < np.cos(np.radians(30.0)):  # two axes generate all rotations
            return Symmetries(np.eye(4)[None], np.eye(3), centre)
    if first is not None:
        point, axis = first
        perpendicular = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        flip = surface.refined(_rotations(centre, perpendicular / np.linalg.norm(perpendicular), np.pi))
        return Symmetries(np.stack([np.eye(4)] if flip is None else [np.eye(4), flip]), axis[None], point)

    elements = [np.eye(4)]
    for order in ROTATION_ORDERS:
        for T in halves if order == 2 else surface.promising(_rotations(centre, lines, 2.0 * np.pi / order)):
            _add_symmetry(elements, T, surface)
    for a in elements:  # grows during the loop: products of symmetries are tried, too
        for b in elements[: len(elements)]:
            _add_symmetry(elements, a @ b, surface)
    return Symmetries(np.stack(elements), np.zeros((0, 3)), centre)


class _SymmetrySurface:
    """A mesh's surface: points on it, and distances from it."""

    def __init__(self, mesh: Mesh) -> None:
        import igl

        self.mesh, self.points = mesh, surface_points(mesh, N_SYMMETRY_POINTS)
        self.tree = igl.AABB()
        self.tree.init(mesh.vertices, mesh.faces)
        self._refined: dict[bytes, ndarray | None] = {}

    def promising(self, rotations: Float[ndarray, "n 4 4"]) -> Float[ndarray, "m 4 4"]:
        """Return the rotations that pass a coarse test, of all at once."""
        for step, times in ((25, 6.0), (5, 3.0)):
            points = se3.transform(rotations, self.points[::step])
            distance = self.nearest(points.reshape(-1, 3))[0].reshape(points.shape[:2])
            rotations = rotations[distance.mean(axis=1) < times * MAX_MEAN_SYMMETRY_DISTANCE * self.mesh.diameter]
        return rotations

    def nearest(self, X: Float[ndarray, "P 3"]) -> tuple[ndarray, ndarray, ndarray]:
        """Return distances [m], nearest points, and normals at these."""
        squared, face, nearest = self.tree.squared_distance(self.mesh.vertices, self.mesh.faces, X)
        return np.sqrt(squared), nearest, self.mesh.planes[face, :3]

    def fits(self, T: Float[ndarray, "4 4"]) -> bool:
        """Return whether the rotated surface lies on the original one."""
        distance = self.nearest(se3.transform(T, self.points))[0] / self.mesh.diameter
        return bool(distance.mean() < MAX_MEAN_SYMMETRY_DISTANCE and distance.max() < MAX_SYMMETRY_DISTANCE)

    def refined(self, rotation: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"] | None:
        """Refine a rotation to the nearest symmetry; None without one. Cached, since half turns are asked for twice."""
        if (key := rotation.tobytes()) not in self._refined:
            self._refined[key] = self._refine(rotation)
        return self._refined[key]

    def _refine(self, rotation: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"] | None:
        few = self.points[::6]
        off = self.nearest(se3.transform(self.aligned(rotation, few), few))[0] / (1.5 * self.mesh.diameter)
        if (
            off.mean() > MAX_MEAN_SYMMETRY_DISTANCE or off.max() > MAX_SYMMETRY_DISTANCE
        ):  # most are far off, and a few points show it
            return None
        T = self.aligned(rotation, self.points)
        moved = se3.angle_between(rotation[:3, :3], T[:3, :3])
        return T if moved < DUPLICATE_SYMMETRY_ANGLE_RAD and self.fits(T) else None

    def aligned(self, rotation: Float[ndarray, "4 4"], points: Float[ndarray, "P 3"]) -> Float[ndarray, "4 4"]:
        """Refine a rotation to its best fit of points to the surface (point-to-plane ICP)."""
        T, size = rotation, self.mesh.diameter
        for _ in range(6):
            X = se3.transform(T, points)
            _, nearest, n = self.nearest(X)
            middle = X.mean(axis=0)
            J = np.concatenate([n, np.cross(X - middle, n) / size], axis=1)
            # The damping fixes free motions: a can's rotation about its axis.
            step = np.linalg.solve(J.T @ J + 1e-3 * len(J) * np.eye(6), J.T @ np.sum(n * (nearest - X), axis=1))
            R = se3.exp_so3(step[3:] / size)
            T = se3.rigid(R, middle - R @ middle + step[:3]) @ T
        return T


def surface_points(mesh: Mesh, count: int) -> Float[ndarray, "count 3"]:
    """Sample points evenly over a surface by area, deterministically."""
    return points_at_samples(mesh, *surface_samples(mesh, count))


def surface_samples(mesh: Mesh, count: int) -> tuple[Int[ndarray, "n"], Float[ndarray, "n 2"]]:
    """Return the face of each of the ``surface_points``, and its coordinates along the face's first two edges."""
    filled = np.cumsum(face_areas(mesh.vertices, mesh.faces))
    face = np.searchsorted(filled, (np.arange(count) + 0.5) / count * filled[-1])
    # The plastic number's low-discrepancy sequence, folded into the triangle.
    u = (0.5 + np.outer(np.arange(count), [0.7548776662466927, 0.5698402909980532])) % 1.0
    return face, np.where(u.sum(axis=1, keepdims=True) > 1.0, 1.0 - u, u)


def points_at_samples(mesh: Mesh, face: Int[ndarray, "n"], along: Float[ndarray, "n 2"]) -> Float[ndarray, "n 3"]:
    """Return a mesh's points at the samples of a mesh with the same faces."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    return np.asarray(a + along[:, :1] * (b - a) + along[:, 1:] * (c - a))


def _moments(mesh: Mesh) -> tuple[Float[ndarray, "3"], Float[ndarray, "3 3"]]:
    """Exact centre [m] and second moment [m^2] of a surface."""
    corners, area = mesh.vertices[mesh.faces], face_areas(mesh.vertices, mesh.faces)
    centre = np.average(corners.mean(axis=1), axis=0, weights=area)
    # Over a triangle the mean of x x^T is (a a^T + b b^T + c c^T + s s^T) / 12, s = a + b + c.
    x = corners - centre
    x = np.concatenate([x, x.sum(axis=1, keepdims=True)], axis=1)
    return centre, np.einsum("fki,fkj,f->ij", x, x, area / (12.0 * area.sum()))


def _candidate_axes(moments: Float[ndarray, "3"], axes: Float[ndarray, "3 3"]) -> Float[ndarray, "n 3"]:
    """Principal axes (moments ascending), and axes between those that are not unique."""
    low, high = moments[1] < AXIS_MOMENT_RATIO * moments[0], moments[2] < AXIS_MOMENT_RATIO * moments[1]
    if low and high:
        z = (np.arange(150) + 0.5) / 150  # Fibonacci points on the half sphere
        angle = np.arange(150) * np.pi * (3.0 - np.sqrt(5.0))
        around = np.stack([np.cos(angle) * np.sqrt(1 - z**2), np.sin(angle) * np.sqrt(1 - z**2), z], axis=1)
        return np.concatenate([axes, around])
    if not (low or high):
        return axes
    i, j = (0, 1) if low else (1, 2)
    angle = np.radians(np.arange(0.0, 180.0, 7.5))[:, None]
    return np.concatenate([axes, np.cos(angle) * axes[i] + np.sin(angle) * axes[j]])


def _rotations(
    point: Float[ndarray, "3"], axis: Float[ndarray, "*batch 3"], angle: float
) -> Float[ndarray, "*batch 4 4"]:
    return se3.rotation_about_line(point, axis, np.full(axis.shape[:-1], angle))


def _continuous_axis(
    surface: _SymmetrySurface, centre: Float[ndarray, "3"], half: Float[ndarray, "4 4"]
) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]] | None:
    """Line (point, direction) of a half turn if all rotations about it are symmetries, else None."""
    w = se3.log_so3(half[:3, :3])
    axis = w / np.linalg.norm(w)
    point = (centre + se3.transform(half, centre[None])[0]) / 2.0  # halfway between a point and its image
    continuous = all(surface.fits(_rotations(point, axis, angle)) for angle in CONTINUOUS_AXIS_ANGLES_RAD)
    return (point, axis) if continuous else None


def _add_symmetry(elements: list[ndarray], T: Float[ndarray, "4 4"], surface: _SymmetrySurface) -> None:
    """Add the symmetry nearest to T, if it exists and is new."""
    if _is_known_symmetry(elements, T):
        return
    refined = surface.refined(T)
    if refined is not None and not _is_known_symmetry(elements, refined):
        elements.append(refined)


def _is_known_symmetry(elements: list[ndarray], T: Float[ndarray, "4 4"]) -> bool:
    return bool(np.any(se3.angle_between(np.stack(elements)[:, :3, :3], T[:3, :3]) < DUPLICATE_SYMMETRY_ANGLE_RAD))
