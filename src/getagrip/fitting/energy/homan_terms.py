"""HOMan's terms, and those built like them: interaction, smoothness and bending in time, and reprojection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic, Term
from getagrip.geometry import se3


@dataclass(frozen=True)
class InteractionTerm:
    """Draws the object's centre to the hand's: ``weight * |c_object - c_hand|^2``."""

    hand: Float[ndarray, "N 3"]
    """The hand's centre in the camera frame [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    name: str = "interaction"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        error = poses.centre - self.hand
        J = np.broadcast_to(np.eye(3, 7), (*error.shape, 7))
        return Quadratic.of_squares(error, J, self.weight)


def vertex_moments(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "4 4"]:
    """Compute four weighted points that move, squared and summed, as the vertices do on average.

    Rows are x, y, z and weight. The mean over the vertices of ``|A x - B x|^2``, for affine A and B, depends on the
    vertices by the mean of ``x x^T`` alone, x homogeneous; the points are the rows of a root of that mean.
    """
    homogeneous = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    values, vectors = np.linalg.eigh(homogeneous.T @ homogeneous / len(vertices))
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


@dataclass(frozen=True)
class SmoothnessTerm:
    """``weight * mean over vertices of |x(n+1) - x(n)|^2``, summed over neighbouring frames, in the camera frame.

    Each frame of a pair has half of the pair's energy in its value.
    """

    moments: Float[ndarray, "4 4"]
    """Second moments of the vertices about the centre, unscaled (``vertex_moments``)."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    name: str = "smoothness"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        B, N = poses.centre.shape[:2]
        points, share = self.moments[:, :3], self.moments[:, 3:]
        arm = poses.scale[:, None, None, None] * points @ np.swapaxes(poses.R, -1, -2)
        step = np.diff(arm + share * poses.centre[:, :, None], axis=1)
        pair = self.weight * np.sum(step**2, axis=(2, 3))
        J = _moments_jacobian(arm, share)
        Jt = np.swapaxes(J, -1, -2)
        pull = 2.0 * self.weight * step.reshape(B, N - 1, 12, 1)
        value, g = np.zeros((B, N)), np.zeros((B, N, 7))
        value[:, :-1] += 0.5 * pair
        value[:, 1:] += 0.5 * pair
        g[:, :-1] -= (Jt[:, :-1] @ pull)[..., 0]
        g[:, 1:] += (Jt[:, 1:] @ pull)[..., 0]
        neighbours = np.full(N, 2.0)
        neighbours[0] -= 1.0
        neighbours[-1] -= 1.0
        H = 2.0 * self.weight * neighbours[:, None, None] * (Jt @ J)
        cross = np.zeros((B, N, 7, N, 7))
        n = np.arange(N - 1)
        block = -2.0 * self.weight * np.swapaxes(Jt[:, :-1] @ J[:, 1:], 0, 1)  # frames first, as the indexing below
        cross[:, n, :, n + 1] = block
        cross[:, n + 1, :, n] = np.swapaxes(block, -1, -2)
        return Quadratic(value, g, H, cross)


def _moments_jacobian(arm: Float[ndarray, "B N 4 3"], share: Float[ndarray, "4 1"]) -> Float[ndarray, "B N 12 7"]:
    """Differentiate four weighted points, their arms from the centre posed, by each frame's local vector."""
    J = np.empty((*arm.shape, 7))
    J[..., :3], J[..., 3:6], J[..., 6] = share[..., None] * np.eye(3), -se3.hat(arm), arm
    return J.reshape(*arm.shape[:2], 12, 7)


@dataclass(frozen=True)
class BendingTerm:
    """``weight * mean over vertices of |x''|^2``, summed over frames: the motion bends little, known frames included.

    Attributes:
        moments: as of ``SmoothnessTerm``.
        weight: energy [px^2 per (m per frame^2)^2].
        index: (N,) the frames of the poses, in their clip.
        known: (n,) other frames, whose poses are fixed: at least one, or two in ``index``.
        R, centre: the poses of the known frames.
    """

    moments: Float[ndarray, "4 4"]
    weight: float
    index: Int[ndarray, "N"]
    known: Int[ndarray, "n"]
    R: Float[ndarray, "n 3 3"]
    centre: Float[ndarray, "n 3"]
    name: str = "bending"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        (B, N), share = poses.centre.shape[:2], self.moments[:, 3:]
        scale = poses.scale[:, None, None, None]
        own, fixed = (scale * self.moments[:, :3] @ np.swapaxes(R, -1, -2) for R in (poses.R, self.R[None]))
        J, known = _moments_jacobian(own, share), fixed + share * self.centre[None, :, None]
        points = np.concatenate([own + share * poses.centre[:, :, None], known], axis=1).reshape(B, -1, 12)
        bends = np.sqrt(self.weight) * second_differences(np.concatenate([self.index, self.known]))
        bent, to_own = bends @ points, bends[:, :N]
        value = np.repeat(np.sum(bent**2, axis=(1, 2))[:, None] / N, N, axis=1)
        g = 2.0 * np.einsum("bnip,mn,bmi->bnp", J, to_own, bent, optimize=True)
        pairs = 2.0 * to_own.T @ to_own
        cross = np.einsum("nk,bnip,bkiq->bnpkq", pairs, J, J, optimize=True)
        n = np.arange(N)
        H = np.moveaxis(cross[:, n, :, n], 1, 0).copy()
        cross[:, n, :, n] = 0.0
        return Quadratic(value, g, H, cross)


def second_differences(frames: Int[ndarray, "N"]) -> Float[ndarray, "M N"]:
    """Return the matrix from values at frames, in any order, to second derivatives at all frames but first and last.

    Each derivative is multiplied by the root of its frame's time span, so that their squares sum to an integral.
    """
    order = np.argsort(frames)
    before, after = np.diff(frames[order])[:-1].astype(float), np.diff(frames[order])[1:].astype(float)
    span, rows = before + after, np.arange(len(before))
    out = np.zeros((len(rows), len(frames)))
    for k, factor in enumerate((1.0 / (before * span), -1.0 / (before * after), 1.0 / (after * span))):
        out[rows, order[rows + k]] = 2.0 * factor * np.sqrt(span / 2.0)
    return out


@dataclass(frozen=True)
class TermInFrame:
    """A term evaluated in a frame other than the camera's; its derivatives are transformed back to the camera's."""

    term: Term
    T_frame_cam: Float[ndarray, "N 4 4"]

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        R = self.T_frame_cam[:, :3, :3]
        centre = se3.transform(self.T_frame_cam, poses.centre[:, :, None])[:, :, 0]
        found = self.term(PosesInCamera(R @ poses.R, np.asarray(centre), poses.scale), bound)
        turn = np.zeros((len(R), 7, 7))
        turn[:, :3, :3] = turn[:, 3:6, 3:6] = R
        turn[:, 6, 6] = 1.0
        back = np.swapaxes(turn, -1, -2)
        cross = found.cross
        if cross is not None:
            cross = np.einsum("nji,bnjmk,mkl->bniml", turn, cross, turn, optimize=True)
        return Quadratic(found.value, (back @ found.g[..., None])[..., 0], back @ found.H @ turn, cross)


@dataclass(frozen=True)
class ReprojectionTerm:
    """Draws a body's points to their observed places u: ``weight * mean over points of |pi(x) - u|^2``.

    pi is the pinhole projection of the crop.
    """

    points: Float[ndarray, "N P 3"]
    """Points of the body in each frame, about its centre, unscaled [m]."""
    K: Float[ndarray, "N 4"]
    """fx, fy, cx, cy [px of the crop]."""
    target: Float[ndarray, "N P 2"]
    """Observed points [px of the crop]."""
    weight: float
    """Energy per squared pixel."""
    name: str = "reprojection"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        arm = poses.scale[:, None, None, None] * self.points @ np.swapaxes(poses.R, -1, -2)
        x = arm + poses.centre[:, :, None]
        z = x[..., 2:]
        f, c = self.K[:, None, :2], self.K[:, None, 2:]
        error = f * x[..., :2] / z + c - self.target
        J_pi = np.zeros((*x.shape[:-1], 2, 3))
        J_pi[..., 0, 0], J_pi[..., 1, 1] = np.moveaxis(f / z, -1, 0)
        J_pi[..., 2] = -f * x[..., :2] / z**2
        J_x = np.concatenate([np.broadcast_to(np.eye(3), (*x.shape, 3)), -se3.hat(arm), arm[..., None]], axis=-1)
        J = (J_pi @ J_x).reshape(*poses.centre.shape[:2], -1, 7)
        found = Quadratic.of_squares(error.reshape(*J.shape[:-1]), J, self.weight / self.points.shape[1])
        return replace(found, value=np.where((z > 0.0).all(axis=(2, 3)), found.value, np.inf))
