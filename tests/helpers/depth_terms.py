"""Depth images of a posed object and hand, exact or with an image's errors, and the term that reads them."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from getagrip.fitting.energy.depth_term import DepthErrors, DepthSamples, DepthTerm, Solid
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.synthetic import objects
from helpers.clips import box

SIDE = 32
K = np.array([[40.0, 0.0, 16.2], [0.0, 41.0, 15.7], [0.0, 0.0, 1.0]])
N = 3
MIDDLE = np.array([0.01, -0.02, 0.03])
"""Of the hand, in its frame [m]."""
OBJECT, HAND = objects.mug(), box(0.09, 0.05, 0.08)
METRIC = DepthErrors(noise=0.004, clip=0.004, frame=0.002, relief=0.05, apart=0.005, warp=0.003)
FREE = DepthErrors(noise=0.004, clip=1.0, frame=0.02, relief=0.15, apart=0.008, warp=0.01)


def poses(rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Rotations (1, N, 3, 3) of object or hand, and places (1, N, 3) of its middle, half a metre away."""
    R = se3.exp_so3(rng.normal(0.0, 0.2, (1, N, 3)) + np.array([0.4, 0.3, 0.0]))
    return R, np.array([0.0, 0.0, 0.55]) + rng.normal(0.0, 0.005, (1, N, 3))


def seen(
    bodies: tuple[tuple[ndarray, ndarray], tuple[ndarray, ndarray]], given: ndarray | None = None
) -> tuple[DepthSamples, ndarray]:
    """Samples of object and hand, posed by (R, centre) each, where both are before nothing; and their depth."""
    depth = []
    for (R, centre), mesh in zip(bodies, (OBJECT, HAND), strict=True):
        vertices = (mesh.vertices - mesh.centre) @ np.swapaxes(R[0], -1, -2) + centre[0, :, None]
        depth.append([depth_and_face(v, mesh.faces, K, (SIDE, SIDE))[0] for v in vertices])
    z = np.array(depth, dtype=float)
    front = np.argmin(z, axis=0)
    places = [[np.argwhere((front[n] == k) & np.isfinite(z[k, n])) for k in (0, 1)] for n in range(N)]
    used = np.array([[len(one) for one in of_frame] for of_frame in places])
    shape = (N, used.sum(axis=1).max())
    place, log_z, weight = np.zeros((*shape, 2), int), np.zeros(shape), np.zeros(shape)
    for n, of_frame in enumerate(places):
        end = used[n].sum()
        place[n, :end] = np.concatenate(of_frame)
        log_z[n, :end] = np.log(z.min(axis=0)[n][tuple(place[n, :end].T)])
        weight[n, :end] = 12.0 / end
    relief = np.where(weight > 0.0, log_z - (log_z * weight).sum(axis=1, keepdims=True) / 12.0, 0.0)
    K4 = np.tile([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], (N, 1))
    hand = np.where(np.arange(shape[1]) >= used[:, :1], log_z, np.nan)
    return DepthSamples(K4, SIDE, place, used[:, 0], used.sum(axis=1), log_z, relief, weight, hand), log_z


def term(samples: DepthSamples, errors: DepthErrors) -> DepthTerm:
    """The term of mug and box."""
    vertices = np.broadcast_to(HAND.vertices - HAND.centre + MIDDLE, (N, *HAND.vertices.shape))
    mug = Solid.of((OBJECT.vertices - OBJECT.centre)[None], OBJECT.faces)
    return DepthTerm(mug, Solid.of(vertices, HAND.faces), samples, errors, weight=30.0)
