"""Terms of the energy at random poses, and what the derivatives of any term must obey."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic, Term, no_bound
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.homan_terms import InteractionTerm, ReprojectionTerm, SmoothnessTerm, vertex_moments
from getagrip.geometry import se3
from getagrip.synthetic import objects
from helpers.clips import box

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
    H = np.zeros((B, N, P, N, P)) if local.cross is None else local.cross.copy()
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
