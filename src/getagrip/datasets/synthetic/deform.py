"""Smooth deformations of objects: a category's CAD model does not have the shape of the object in the hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.warp import align_similarity

N_WAVES = 6
WAVELENGTH_RANGE_DIAMETERS = (0.8, 2.0)
"""Shortest and longest wave, in diameters of the object: long enough that the surface does not fold."""


@dataclass(frozen=True)
class Deformation:
    """Points moved by a few sine waves.

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
    """Draw a random deformation that leaves the mesh off by ``share`` of its diameter (root mean square).

    Counted is what no similarity undoes.
    """
    waves = rng.normal(size=(N_WAVES, 3))
    waves *= (
        2.0
        * np.pi
        / (
            mesh.diameter
            * rng.uniform(*WAVELENGTH_RANGE_DIAMETERS, (N_WAVES, 1))
            * np.linalg.norm(waves, axis=1)[:, None]
        )
    )
    unit = Deformation(
        waves, rng.uniform(0.0, 2.0 * np.pi, N_WAVES), 1e-3 * mesh.diameter * rng.normal(size=(N_WAVES, 3))
    )
    deformed = Mesh(unit(mesh.vertices), mesh.faces)
    return replace(unit, amplitude=unit.amplitude * share * mesh.diameter / misfit(mesh, deformed))


def misfit(cad: Mesh, grasped: Mesh) -> float:
    """Compute the root mean square distance of corresponding points of the surfaces after the best similarity [m]."""
    T, size = align_similarity(cad, grasped, resize=True)
    off = np.sum((se3.transform(T, size * cad.vertices) - grasped.vertices) ** 2, axis=1)
    return float(np.sqrt(grasped.vertex_areas @ off / grasped.vertex_areas.sum()))
