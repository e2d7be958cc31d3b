"""The form of a mesh: a body's surface has no large holes and is neither flat nor a needle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import close_holes


def hole_share(mesh: Mesh) -> float:
    """Compute the share of the holes in the area of mesh and holes together; holes are closed by fans."""
    vertices, faces = close_holes(mesh.vertices, mesh.faces)
    area = _areas(vertices, faces)
    return float(area[len(mesh.faces) :].sum() / area.sum())


def extents(mesh: Mesh) -> Float[ndarray, "3"]:
    """Return the sides of the box around the mesh along its principal axes.

    The smallest comes first; they are shares of the largest.
    """
    about = mesh.vertices - mesh.vertices.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(about.T))
    sides = np.sort(np.ptp(about @ axes, axis=0))
    return np.asarray(sides / sides[-1])


def _areas(vertices: Float[ndarray, "V 3"], faces: ndarray) -> Float[ndarray, "F"]:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
