"""An object's surface about its centre, by which the search measures how far apart two poses are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.fitting.contact import build_contact_grid, rms_distances
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.kernels.closest import FaceGrid

MAX_COARSE_FACES = 1000
"""Most faces for contact and for 64-pixel silhouettes; larger objects are decimated."""
N_SURFACE_POINTS = 48
"""Points of the surface that are compared."""
HALF_TURN_DISTANCE_RANGE = (0.003, 0.06)
"""A half turn about a principal axis nearly leaves the surface as it is, where it moves it by so much [diameters]: less
is not seen, and after more another fit is not taken for a copy (``search.SAME``)."""
HALF_TURN_TOLERANCE_RAD = np.radians(30.0)
"""Fits of an object both ways round differ by half a turn, but for so much."""


@dataclass(frozen=True)
class ObjectSurface:
    """The surface of a rigid object.

    Attributes:
        coarse: the mesh, decimated.
        solid: its surface about the centre of the mesh as it was given.
        points: (P, 3) points of the surface, about that centre.
        axes: (3, 3) principal axes of the vertices, one a row.
        diameter: of the mesh [m].
    """

    coarse: Mesh
    solid: FaceGrid
    points: Float[ndarray, "P 3"]
    axes: Float[ndarray, "3 3"]
    diameter: float

    @staticmethod
    def of(mesh: Mesh) -> ObjectSurface:
        """Sample the surface of a mesh, about ``mesh.centre``."""
        coarse = decimate(mesh, MAX_COARSE_FACES)
        about = mesh.vertices - mesh.centre
        _, axes = np.linalg.eigh(np.cov(about.T))
        spread = np.linspace(0, len(about) - 1, min(N_SURFACE_POINTS, len(about))).round().astype(int)
        return ObjectSurface(coarse, build_contact_grid(coarse, mesh.centre), about[spread], axes.T, mesh.diameter)

    @cached_property
    def half_turns(self) -> Float[ndarray, "T 3 3"]:
        """Half turns about the principal axes that nearly leave the surface as it is: T from 0 to 3."""
        turns = se3.exp_so3(np.pi * self.axes)
        moved = self.moved_by(turns)
        return turns[(moved > HALF_TURN_DISTANCE_RANGE[0]) & (moved < HALF_TURN_DISTANCE_RANGE[1])]

    def moved_by(self, turns: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T"]:
        """Return how far turns move the surface, root mean square distance [diameters]."""
        middle = np.zeros((len(turns), 1, 3))
        return self.rms_distance(np.eye(3)[None], np.zeros((1, 3)), 1.0, turns[:, None], middle, np.ones(len(turns)))

    def half_turned(self, R: Float[ndarray, "N 3 3"], others: Float[ndarray, "C N 3 3"]) -> Bool[ndarray, "C"]:
        """Return which of C other rotations, over N frames, differ by one of the half turns."""
        between = np.swapaxes(R, -1, -2) @ others
        off = [se3.angle_between(between, turn).max(axis=-1) for turn in self.half_turns]
        return np.any(np.array(off).reshape(-1, len(others)) < HALF_TURN_TOLERANCE_RAD, axis=0)

    def rms_distance(
        self,
        R: Float[ndarray, "N 3 3"],
        centre: Float[ndarray, "N 3"],
        scale: float,
        others_R: Float[ndarray, "C N 3 3"],
        others_centre: Float[ndarray, "C N 3"],
        others_scale: Float[ndarray, "C"],
        within: float = np.inf,
    ) -> Float[ndarray, "C"]:
        """Compute the root mean square distance of the posed surface from C other poses of it, in diameters.

        A bottle that is rotated about its axis has not moved. Where the two are far apart, this is a lower bound, and
        infinite where it is more than ``within``.
        """
        arrays = map(np.ascontiguousarray, (R, centre, others_R, others_centre, others_scale))
        at_R, at_centre, *others = arrays
        found = rms_distances(self.points, at_R, at_centre, scale, *others, within * self.diameter, *self.solid.tables)
        return np.asarray(found / self.diameter)
