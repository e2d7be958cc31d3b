"""A term whose masks were drawn at known poses, and the energy of silhouettes drawn finer than masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX, MaskTerm, SilhouetteMesh, observe_masks
from getagrip.geometry import se3
from getagrip.geometry.kernels import silhouette
from getagrip.geometry.kernels.silhouette import pack, silhouettes, unpack
from getagrip.geometry.mesh import Mesh
from helpers.parts import callable_part
from helpers.terms import MESHES

mismatch = callable_part(silhouette.mismatch)

SIZE = 300
CAMERA = np.array([[560.0, 0.0, 148.0], [0.0, 570.0, 152.0], [0.0, 0.0, 1.0]])


def rendered(mesh: Mesh, poses: PosesInCamera, K: ndarray, shape: tuple[int, int]) -> ndarray:
    """Masks (N, h, w) of the first hypothesis."""
    t = SilhouetteMesh.of(mesh, mesh.centre)
    N = len(K)
    bits = np.empty((N, shape[0], -(-shape[1] // 64)), np.uint64)
    scale = np.full(N, poses.scale[0])
    silhouettes(poses.R[0], poses.centre[0], scale, t.vertices, t.planes, t.edges, t.closed, K, bits)
    return unpack(bits, shape[1])


def scene(which: str, seed: int = 0, frames: int = 2, occluded: bool = False) -> tuple[MaskTerm, PosesInCamera]:
    """A term whose masks were drawn at the poses that come with it."""
    rng = np.random.default_rng([seed, *which.encode()])
    mesh = MESHES[which]
    R = se3.exp_so3(rng.normal(size=(frames, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.02, 0.02, (frames, 3))
    truth = PosesInCamera(R[None], centre[None], np.ones(1))
    K4 = np.tile(CAMERA[[0, 1, 0, 1], [0, 1, 2, 2]], (frames, 1))
    seen = rendered(mesh, truth, K4, (SIZE, SIZE))
    ignore = np.zeros_like(seen)
    if occluded:
        i, j = np.indices((SIZE, SIZE))
        ignore[:] = (i - 0.6 * j > 90.0) & (i - 0.6 * j < 125.0)
    observation = observe_masks(Masks(seen & ~ignore, ignore), np.tile(CAMERA, (frames, 1, 1)))
    # Drawn again in the crops, so that no pixel differs at the truth.
    valid = unpack(observation.valid[MASK_CROP_SIZE_PX], MASK_CROP_SIZE_PX)
    exact = pack(rendered(mesh, truth, observation.K, (MASK_CROP_SIZE_PX, MASK_CROP_SIZE_PX)) & valid)
    observation = replace(observation, observed={**observation.observed, MASK_CROP_SIZE_PX: exact})
    return MaskTerm(SilhouetteMesh.of(mesh, mesh.centre), observation), truth


def enlarged(mask: ndarray, finer: int) -> ndarray:
    return mask.repeat(finer, axis=0).repeat(finer, axis=1)


def smooth_energy(term: MaskTerm, mesh: Mesh, poses: PosesInCamera, finer: int = 8) -> ndarray:
    """E_mask (1, N) of silhouettes drawn finer than the masks, as ``reference.mask_energy`` says."""
    o = term.observation
    drawn = pack(rendered(mesh, poses, o.K * finer, (MASK_CROP_SIZE_PX * finer, MASK_CROP_SIZE_PX * finer)))
    energy = [
        mismatch(
            drawn[n],
            *(
                pack(enlarged(unpack(bits[MASK_CROP_SIZE_PX][n], MASK_CROP_SIZE_PX), finer))
                for bits in (o.observed, o.valid)
            ),
        )
        for n in range(len(drawn))
    ]
    return np.array([energy]) / finer**2
