"""Profiles: the radii of a body of revolution at heights along its axis, before and after a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.io.array_data import ArrayData

N_PROFILE_RADII = 10
"""Number of radii along an axis."""
PROFILE_END_SHARE = 0.02
"""Share of the height by which the first and last measured section are inside the body: its ends are flat."""


@dataclass(frozen=True, eq=False)
class Profile(ArrayData):
    """A change of the radii of a body about an axis along z; between the heights radii are interpolated.

    Points on the body move out by the change of its radius at their height. Inner points move in proportion to their
    distance from the axis, and outer ones, of a handle or a spout, as the body's surface at their height does.

    Attributes:
        axis: (2,) x and y of the axis [m].
        ends: (2,) lowest and highest of the K heights, which are evenly spaced [m].
        before: (K,) radii of the input body [m].
        after: (K,) radii of the fitted body [m].
    """

    axis: Float[ndarray, "2"]
    ends: Float[ndarray, "2"]
    before: Float[ndarray, "K"]
    after: Float[ndarray, "K"]

    @staticmethod
    def of(mesh: Mesh) -> Profile:
        """Measure a body whose handles and spouts lie along x, as the built-in shapes' do; nothing changes yet."""
        widest = mesh.vertices[np.abs(mesh.vertices[:, 1]).argmax()]
        ring = mesh.vertices[np.abs(mesh.vertices[:, 2] - widest[2]) < 1e-6 * mesh.diameter]
        ring = ring[np.abs(ring[:, 1]) > 0.5 * np.abs(widest[1])]  # the body's, not a handle's
        circle = np.column_stack([2.0 * ring[:, 0], np.ones(len(ring))])
        axis = np.array([np.linalg.lstsq(circle, np.sum(ring[:, :2] ** 2, axis=1), rcond=None)[0][0], 0.0])
        off = np.hypot(*(mesh.vertices[:, :2] - axis).T)
        body = mesh.vertices[off < 1.001 * np.hypot(*(widest[:2] - axis)), 2]
        heights = np.linspace(body.min(), body.max(), N_PROFILE_RADII)
        inside = PROFILE_END_SHARE * np.ptp(body)
        radii = np.array([_half_width(mesh, z) for z in np.clip(heights, body.min() + inside, body.max() - inside)])
        return Profile(axis, heights[[0, -1]], radii, radii)

    @property
    def heights(self) -> Float[ndarray, "K"]:
        """Heights of the radii along the axis [m]."""
        return np.linspace(self.ends[0], self.ends[1], len(self.before))

    def widened(self, times: Float[ndarray, "K"]) -> Profile:
        """Return the profile with radii that are these multiples of the input body's."""
        return replace(self, after=self.before * times)

    def moved(self, X: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Return points of the input body on the fitted body [m]."""
        before, after = (np.interp(X[:, 2], self.heights, radii) for radii in (self.before, self.after))
        out = X[:, :2] - self.axis
        r = np.maximum(np.hypot(*out.T), 1e-12)
        moved = X.copy()
        moved[:, :2] += out * ((after - before) * np.minimum(r / before, 1.0) / r)[:, None]
        return moved


def _half_width(mesh: Mesh, height: float) -> float:
    """Measure the largest distance from the plane y = 0 of a mesh's section [m]."""
    ends = mesh.vertices[np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])]
    crossing = ends[(ends[:, 0, 2] > height) != (ends[:, 1, 2] > height)]
    low, high = crossing[:, 0], crossing[:, 1]
    share = (height - low[:, 2]) / (high[:, 2] - low[:, 2])
    return float(np.abs(low[:, 1] + share * (high[:, 1] - low[:, 1])).max())
