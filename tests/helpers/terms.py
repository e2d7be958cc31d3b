"""Terms of the energy at random poses, and what the derivatives of any term must obey.

Depth images of a posed object and hand, exact or with an image's errors, and the term that reads them.

A term whose masks were drawn at known poses, and the energy of silhouettes drawn finer than masks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.fitting.energy import PosesInCamera, Quadratic, Term, no_bound
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.depth_term import DepthErrors, DepthSamples, DepthTerm, Solid
from getagrip.fitting.energy.homan_terms import InteractionTerm, ReprojectionTerm, SmoothnessTerm, vertex_moments
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX, MaskTerm, SilhouetteMesh, observe_masks
from getagrip.geometry import se3
from getagrip.geometry.kernels import silhouette
from getagrip.geometry.kernels.silhouette import pack, silhouettes, unpack
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import depth_and_face
from getagrip.synthetic import objects
from helpers.clips import box
from helpers.kernels import callable_part

B, N = 2, 4
"""Hypotheses and frames."""
K4 = np.tile([560.0, 570.0, 128.0, 120.0], (N, 1))
MESHES = {"box": box(0.1, 0.06, 0.04), "mug": objects.mug(), "spoon": objects.spoon()}


def random_poses(rng: np.random.Generator, hypotheses: int = B, frames: int = N) -> PosesInCamera:
    """Objects turned at random, about half a metre before the camera."""
    R = se3.exp_so3(rng.normal(size=(hypotheses, frames, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.01, (hypotheses, frames, 3))
    return PosesInCamera(R, centre, rng.uniform(0.8, 1.2, hypotheses))


def moved(poses: PosesInCamera, step: ndarray) -> PosesInCamera:
    """Poses after a local 7-vector of all frames (7,) or of each (N, 7); the scale, which is shared, by the mean."""
    scale = poses.scale * np.exp(np.mean(step[..., 6]))
    return PosesInCamera(se3.exp_so3(step[..., 3:6]) @ poses.R, poses.centre + step[..., :3], scale)


def some_term(kind: str, rng: np.random.Generator) -> Term:
    """A term of a kind, its observations at random."""
    points = rng.normal(0.0, 0.03, (N, 5, 3))
    match kind:
        case "consistency":
            hand = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.04, (N, 6, 3))
            return ContactConsistencyTerm(points[0], hand, 1e6 * np.arange(1.0, N + 1.0), delta=1e-3)
        case "smoothness":
            return SmoothnessTerm(vertex_moments(points[0]), 1e5)
        case "reprojection":
            return ReprojectionTerm(points, K4, rng.uniform(0.0, 256.0, (N, 5, 2)), 3.0)
        case _:
            return InteractionTerm(np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (N, 3)), 1e4)


def total_hessian(local: Quadratic) -> ndarray:
    """The whole Hessian (B, P N, P N), frames tied to each other."""
    P = local.g.shape[-1]
    between = local.between_frames
    H = np.zeros((B, N, P, N, P)) if between is None else between.copy()
    for n in range(N):
        H[:, n, :, n] += local.H[:, n]
    return H.reshape(B, P * N, P * N)


def differences(energy: Callable[[PosesInCamera], ndarray], poses: PosesInCamera, steps: ndarray) -> ndarray:
    """Central differences (B, N, 7) of per-frame energies (B, N) by the local 7-vector, step by step."""
    out = []
    for k, step in enumerate(steps):
        ahead, behind = (moved(poses, sign * step * np.eye(7)[k]) for sign in (1.0, -1.0))
        out.append((energy(ahead) - energy(behind)) / (2.0 * step))
    return np.stack(out, axis=-1)


def is_trustworthy(local: Quadratic) -> None:
    """Every Hessian is symmetric and positive semi-definite."""
    np.testing.assert_array_equal(local.H, np.swapaxes(local.H, -1, -2))
    eigenvalues = np.linalg.eigvalsh(local.H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max(initial=1.0)).all()


def hypotheses_are_independent(term: Term, poses: PosesInCamera) -> None:
    """Each hypothesis alone gives what it gives among the others."""
    together = term(poses, no_bound(poses))
    for b in range(len(poses.scale)):
        one = PosesInCamera(poses.R[[b]], poses.centre[[b]], poses.scale[[b]])
        alone = term(one, no_bound(one))
        np.testing.assert_array_equal(alone.value[0], together.value[b])
        np.testing.assert_array_equal(alone.g[0], together.g[b])
        np.testing.assert_array_equal(alone.H[0], together.H[b])


SIDE = 32
K = np.array([[40.0, 0.0, 16.2], [0.0, 41.0, 15.7], [0.0, 0.0, 1.0]])
N_DEPTH_POSES = 3
MIDDLE = np.array([0.01, -0.02, 0.03])
"""Of the hand, in its frame [m]."""
OBJECT, HAND = objects.mug(), box(0.09, 0.05, 0.08)
METRIC = DepthErrors(noise=0.004, clip=0.004, frame=0.002, relief=0.05, apart=0.005, warp=0.003)
FREE = DepthErrors(noise=0.004, clip=1.0, frame=0.02, relief=0.15, apart=0.008, warp=0.01)


def poses(rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Rotations (1, N, 3, 3) of object or hand, and places (1, N, 3) of its middle, half a metre away."""
    R = se3.exp_so3(rng.normal(0.0, 0.2, (1, N_DEPTH_POSES, 3)) + np.array([0.4, 0.3, 0.0]))
    return R, np.array([0.0, 0.0, 0.55]) + rng.normal(0.0, 0.005, (1, N_DEPTH_POSES, 3))


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
    places = [[np.argwhere((front[n] == k) & np.isfinite(z[k, n])) for k in (0, 1)] for n in range(N_DEPTH_POSES)]
    used = np.array([[len(one) for one in of_frame] for of_frame in places])
    shape = (N_DEPTH_POSES, used.sum(axis=1).max())
    place, log_z, weight = np.zeros((*shape, 2), int), np.zeros(shape), np.zeros(shape)
    for n, of_frame in enumerate(places):
        end = used[n].sum()
        place[n, :end] = np.concatenate(of_frame)
        log_z[n, :end] = np.log(z.min(axis=0)[n][tuple(place[n, :end].T)])
        weight[n, :end] = 12.0 / end
    relief = np.where(weight > 0.0, log_z - (log_z * weight).sum(axis=1, keepdims=True) / 12.0, 0.0)
    K4 = np.tile([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], (N_DEPTH_POSES, 1))
    hand = np.where(np.arange(shape[1]) >= used[:, :1], log_z, np.nan)
    return DepthSamples(K4, SIDE, place, used[:, 0], used.sum(axis=1), log_z, relief, weight, hand), log_z


def term(samples: DepthSamples, errors: DepthErrors) -> DepthTerm:
    """The term of mug and box."""
    vertices = np.broadcast_to(HAND.vertices - HAND.centre + MIDDLE, (N_DEPTH_POSES, *HAND.vertices.shape))
    mug = Solid.of((OBJECT.vertices - OBJECT.centre)[None], OBJECT.faces)
    return DepthTerm(mug, Solid.of(vertices, HAND.faces), samples, errors, weight=30.0)


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
