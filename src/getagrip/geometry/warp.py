"""Smooth warps: deformations of a mesh into another shape of its category."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.profile import Profile
from getagrip.io.array_data import ArrayData

N_MONOMIALS = 10
"""1, x, y, z, xx, xy, xz, yy, yz, zz."""


@dataclass(frozen=True, eq=False)
class Warp(ArrayData):
    """A smooth deformation of a mesh: ``X' = centre + radius * M(x) @ coefficients``, ``x = (X - centre) / radius``.

    M(x) are the monomials of x up to the second degree, which stretch, shear, taper and bend the mesh. Before that a
    profile changes the radii of a body of revolution.

    Attributes:
        centre: (3,) the point about which x is measured [m].
        radius: the unit of length of x [m].
        coefficients: (10, 3) of 1, x, y, z, xx, xy, xz, yy, yz, zz.
        profile: the change of the body's radii; None: none.
    """

    centre: Float[ndarray, "3"]
    radius: float
    coefficients: Float[ndarray, "10 3"]
    profile: Profile | None = None

    @staticmethod
    def by(
        centre: Float[ndarray, "3"], radius: float, displacement: Float[ndarray, "9 3"], profile: Profile | None = None
    ) -> Warp:
        """Make a warp from ``displacement``: the coefficients of all monomials but 1, relative to the identity."""
        coefficients = np.zeros((N_MONOMIALS, 3))
        coefficients[1:] = displacement
        coefficients[1:4] += np.eye(3)
        return Warp(centre, radius, coefficients, profile)

    def __call__(self, mesh: Mesh) -> Mesh:
        """Deform a mesh."""
        return replace(mesh, vertices=self.moved(mesh.vertices))

    def moved(self, X: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Return the deformed points [m]."""
        x = (self._with_profile(X) - self.centre) / self.radius
        return np.asarray(self.centre + self.radius * (monomials(x) @ self.coefficients))

    def _with_profile(self, X: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        return X if self.profile is None else self.profile.moved(X)

    def expansion(self, X: Float[ndarray, "n 3"]) -> Float[ndarray, "n"]:
        """Return the factor by which volume grows at points; negative where the warp turns space inside out.

        The profile, which turns nothing inside out, does not count.
        """
        x = (self._with_profile(X) - self.centre) / self.radius
        J = np.repeat(self.coefficients[None, 1:4], len(x), axis=0)  # rows: by x, y, z
        for bend, i, j in zip(self.coefficients[4:], *np.triu_indices(3), strict=True):
            J[:, i] += x[:, j, None] * bend
            J[:, j] += x[:, i, None] * bend
        return np.asarray(np.linalg.det(J))

    def displacement(self, mesh: Mesh) -> float:
        """Compute the root mean square displacement of a mesh's surface [m]."""
        squared = np.sum((self.moved(mesh.vertices) - mesh.vertices) ** 2, axis=1)
        return float(np.sqrt(np.average(squared, weights=mesh.vertex_areas)))


def remove_similarity(warp: Warp, mesh: Mesh, resize: bool) -> tuple[Warp, Float[ndarray, "4 4"], float]:
    """Split a warp into a pure deformation of the mesh and a similarity (T, size); size is 1 unless ``resize``.

    ``warp.moved(X) = T (size * deformation.moved(X))``. The mesh and its deformed shape have the same pose: no
    similarity brings the mesh nearer to it (``align_similarity``).
    """
    T, size = align_similarity(mesh, warp(mesh), resize)
    R, shift = T[:3, :3], T[:3, 3]
    coefficients = warp.coefficients @ R / size
    coefficients[0] += (R.T @ (warp.centre - shift) / size - warp.centre) / warp.radius
    return replace(warp, coefficients=coefficients), T, size


def monomials(x: Float[ndarray, "n 3"]) -> Float[ndarray, "n 10"]:
    """Return 1, x, y, z, xx, xy, xz, yy, yz, zz of each point."""
    first, second = np.triu_indices(3)
    return np.concatenate([np.ones((len(x), 1)), x, x[:, first] * x[:, second]], axis=1)


def align_similarity(mesh: Mesh, other: Mesh, resize: bool) -> tuple[Float[ndarray, "4 4"], float]:
    """Return ``T_other_mesh`` and the scale that align a mesh with another one with the same faces.

    They minimise sum_i a_i |x_i - (R s y_i + t)|^2 over corresponding vertices x of ``other`` and y of ``mesh``, with
    a_i the vertex areas of ``other``; s stays 1 unless ``resize`` (Umeyama, "Least-squares estimation of transformation
    parameters", 1991).
    """
    a = other.vertex_areas / other.vertex_areas.sum()
    x0, y0 = a @ other.vertices, a @ mesh.vertices
    x, y = other.vertices - x0, mesh.vertices - y0
    R = se3.nearest_rotation((a[:, None] * x).T @ y)
    size = float(np.sum(a[:, None] * x * (y @ R.T)) / np.sum(a[:, None] * y * y)) if resize else 1.0
    return se3.rigid(R, x0 - size * R @ y0), size
