"""From joints clicked on a few frames to a hand in every frame: the generic hand, one shape, one way to hold.

Minimised is, over the shape b, the grasp g, and for each clicked frame n the pose q_n and the rigid motion T_n,

    sum_n,i rho(|project(K, T_n X_i(b, q_n)) - y_n,i| / noise_n,i) + sum_n |q_n - g|^2 / LOOSENESS^2
        + |prior(g)|^2 + |b / spread|^2

by Levenberg-Marquardt on the block-arrow normal equations of ``hands.fit``, with rho(r) = c^2 log(1 + r^2 / c^2)
(Cauchy), so that a few wrong clicks count little. The fingers of a hand that holds something hardly move: joints that
are hidden in one frame are known from the others.

One view tells neither the size of a hand nor its distance. The size is that of the generic hand, a guess, and the
distance follows from it. Between clicked frames the hand moves smoothly; before the first and after the last it stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip import se3
from getagrip.camera import backproject, project
from getagrip.clip import HandTrack
from getagrip.errors import UsageError
from getagrip.hands import generic
from getagrip.hands.fit import JOINT_NOISE, Chains, arrow_step, joints_and_jacobian
from getagrip.hands.model import KNUCKLES, HandModel, Side, hand_track
from getagrip.hands.pose_prior import PosePrior

SCALE = "a guess: the generic hand has the size of a mean one, and its distance follows from that"

FEWEST = 6
"""Joints that a frame must have."""
CLICK_NOISE = 0.005
"""Standard deviation of a click beside that of the joints themselves, at the hand [m]."""
OUTLIER = 2.5
"""Clicks beyond so many standard deviations are doubted."""
LOOSENESS = 0.12
"""Standard deviation of each number of the fingers' pose from that of the grasp [rad]."""
CURLS = (0.3, 0.8)
"""Bends of the fingers' joints that are tried at first [rad]."""
ROTATIONS = 48
"""Rotations of the hand that are tried at first."""
PLACING_STEPS, STEPS = 12, 60
TOLERANCE = 1e-5
"""Stop when a step lowers the cost by less than this share of it."""
SHARED = 45
"""Numbers of the grasp, after the frames' 51 and before the shape."""


@dataclass(frozen=True)
class ClickedHands:
    """A hand in every frame, fitted to clicks on some of them."""

    hand: HandTrack
    """In each frame from the first to the last."""
    keys: tuple[int, ...]
    """The frames that were clicked."""
    residuals: Float[ndarray, "n 21"]
    """Distance of each fitted joint from its click [px]; NaN where there is none."""
    doubtful: Bool[ndarray, "n 21"]
    """Clicks that do not fit the others."""
    shape: Float[ndarray, "S"]


def hands_from_clicks(
    clicks: Mapping[int, Float[ndarray, "21 2"]], K: Float[ndarray, "3 3"], side: Side, first: int, last: int
) -> ClickedHands:
    """The hand in the frames ``first`` to ``last``, both included, from joints clicked on some of them [px].

    ``clicks`` are wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip, NaN where not clicked.
    Raises ``UsageError`` for no clicked frame, for one with fewer than ``FEWEST`` joints or outside the interval.
    """
    _check(clicks, first, last)
    keys = tuple(sorted(clicks))
    seen = Seen.of(K, np.array([clicks[n] for n in keys], dtype=float))
    model = generic.load(side)
    chains, prior = Chains.of(model), PosePrior.of(model)
    found = min((_fit(model, chains, prior, seen, curl) for curl in CURLS), key=lambda each: each[1])[0]
    X, _ = joints_and_jacobian(chains, found.q, found.shape)
    offset = project(K, se3.transform(found.T, X)) - seen.y
    residuals = np.where(seen.there, np.linalg.norm(offset, axis=-1), np.nan)
    doubtful = seen.there & (residuals > OUTLIER * seen.noise)
    T, q = between(keys, found.T, found.q, first, last)
    posed = model.with_shape(found.shape).with_pose(model_pose(q))
    return ClickedHands(hand_track(posed, T), keys, residuals, doubtful, found.shape)


def _check(clicks: Mapping[int, Float[ndarray, "21 2"]], first: int, last: int) -> None:
    if not clicks:
        raise UsageError("joints: got no frame with any, expected one at least")
    for n, points in clicks.items():
        if not first <= n <= last:
            raise UsageError(f"joints: got some on frame {n}, expected them on frames {first} to {last}")
        if np.shape(points) != (21, 2) or np.isinf(points).any():
            raise UsageError(f"joints of frame {n}: got an array of shape {np.shape(points)}, expected (21, 2), finite")
        count = int(np.count_nonzero(~np.isnan(points).any(axis=1)))
        if count < FEWEST:
            raise UsageError(f"joints of frame {n}: got {count}, expected {FEWEST} at least, or none")


class Seen(NamedTuple):
    """Clicked joints."""

    K: Float[ndarray, "3 3"]
    y: Float[ndarray, "n 21 2"]
    """Pixels; zero where not clicked."""
    there: Bool[ndarray, "n 21"]
    noise: Float[ndarray, "n 21"]
    """Standard deviation of each [px]."""

    @staticmethod
    def of(K: Float[ndarray, "3 3"], points: Float[ndarray, "n 21 2"]) -> Seen:
        """The noise is known in metres; the hand's extent tells how many pixels these are."""
        there = ~np.isnan(points).any(axis=-1)
        flat = generic.load("right").with_shape().with_pose().joints
        per_metre = np.array([_spread(y[seen]) / _spread(flat[seen]) for y, seen in zip(points, there, strict=True)])
        noise = per_metre[:, None] * np.hypot(JOINT_NOISE, CLICK_NOISE)
        return Seen(K, np.where(there[..., None], points, 0.0), there, noise)


def _spread(points: Float[ndarray, "n d"]) -> float:
    """Mean distance from the middle, at least a trifle."""
    return max(float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean()), 1e-6)


class Guess(NamedTuple):
    """What is sought."""

    T: Float[ndarray, "n 4 4"]
    """T_cam_hand."""
    q: Float[ndarray, "n 5 3 3"]
    """Rotation vectors of the fingers' joints."""
    grasp: Float[ndarray, "1 5 3 3"]
    """What all q are near to."""
    shape: Float[ndarray, "S"]

    def moved(self, frames: Float[ndarray, "n 51"], shared: Float[ndarray, "s"], wrist: Float[ndarray, "3"]) -> Guess:
        """After a step: each hand shifts in its own axes and turns about the wrist, the rest adds up."""
        return Guess(
            turned(self.T, frames[:, :6], wrist),
            self.q + frames[:, 6:].reshape(self.q.shape),
            self.grasp + shared[:SHARED].reshape(self.grasp.shape),
            self.shape + shared[SHARED:],
        )


def turned(
    T: Float[ndarray, "n 4 4"], step: Float[ndarray, "n 6"], wrist: Float[ndarray, "3"]
) -> Float[ndarray, "n 4 4"]:
    """Hands shifted in their own axes and turned about the wrist."""
    R = se3.exp_so3(step[:, 3:])
    return T @ se3.rigid(R, step[:, :3] + wrist - R @ wrist)


def _fit(model: HandModel, chains: Chains, prior: PosePrior, seen: Seen, curl: float) -> tuple[Guess, float]:
    """The best hands whose fingers are at first bent by ``curl`` [rad], and their cost."""
    grasp = prior.mean.copy()
    grasp[1:] = curl * prior.axes[1:, :, 1]
    n = len(seen.y)
    guess = Guess(
        _place(chains, seen, grasp), np.tile(grasp, (n, 1, 1, 1)), grasp[None], np.zeros(len(model.shape_names))
    )
    cost, H, g = _normal_equations(model, chains, prior, guess, seen)
    damping = 1e-3
    for _ in range(STEPS):
        new = guess.moved(*arrow_step(H, g, damping), chains.wrist)
        new_cost, new_H, new_g = _normal_equations(model, chains, prior, new, seen)
        done = damping > 1e8
        if new_cost > cost:
            damping *= 10.0
        else:
            done = cost - new_cost < TOLERANCE * cost
            guess, cost, H, g, damping = new, new_cost, new_H, new_g, max(damping / 10.0, 1e-9)
        if done:
            break
    return guess, cost


def _normal_equations(
    model: HandModel, chains: Chains, prior: PosePrior, guess: Guess, seen: Seen
) -> tuple[float, Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
    """The cost, and per frame J^T J and J^T r of (T_cam_hand step, pose, grasp, shape)."""
    n, S = len(seen.y), len(guess.shape)
    X, J_hand = joints_and_jacobian(chains, guess.q, guess.shape)
    J = np.zeros((n, 21, 3, 51 + SHARED + S))
    J[..., :51], J[..., 51 + SHARED :] = J_hand[..., :51], J_hand[..., 51:]
    cost, H, g = _clicks(seen, guess.T, X, J)
    i = np.arange(45)
    off = (guess.q - guess.grasp).reshape(n, 45) / LOOSENESS
    for at, sign in ((6, 1.0), (51, -1.0)):
        H[:, at + i, at + i] += 1.0 / LOOSENESS**2
        H[:, at + i, 57 - at + i] -= 1.0 / LOOSENESS**2
        g[:, at + i] += sign * off / LOOSENESS
    # What is shared has its own priors; they are shared out among the frames, so that the sum has them once.
    p, P = prior.residuals(guess.grasp)
    b = guess.shape / model.shape_spread
    H[:, 51:96, 51:96] += P[0].T @ P[0] / n
    g[:, 51:96] += p[0] @ P[0] / n
    H[:, 96:, 96:] += np.diag(1.0 / model.shape_spread**2) / n
    g[:, 96:] += b / model.shape_spread / n
    return cost + float(np.sum(off**2) + np.sum(p**2) + b @ b), H, g


def _clicks(
    seen: Seen, T: Float[ndarray, "n 4 4"], X: Float[ndarray, "n 21 3"], J: Float[ndarray, "n 21 3 D"]
) -> tuple[float, Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
    """The clicks' share of the normal equations, for the derivatives J of the joints X in the hand's axes."""
    costs, H, g = _each_frame(seen, T, X, J)
    return float(costs.sum()), H, g


def _each_frame(
    seen: Seen, T: Float[ndarray, "n 4 4"], X: Float[ndarray, "n 21 3"], J: Float[ndarray, "n 21 3 D"]
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
    X_cam = se3.transform(T, X)
    z = np.maximum(X_cam[..., 2], 0.01)  # behind the camera nothing can be fitted; the cost there is large
    X_cam = np.concatenate([X_cam[..., :2], z[..., None]], axis=-1)
    r = (project(seen.K, X_cam) - seen.y) / seen.noise[..., None]
    weight = seen.there / (1.0 + np.sum(r * r, axis=-1) / OUTLIER**2)  # of Cauchy's rho, for J^T J
    fx, fy = seen.K[0, 0], seen.K[1, 1]
    D = np.zeros((*z.shape, 2, 3))
    D[..., 0, 0], D[..., 0, 2] = fx / z, -fx * X_cam[..., 0] / z**2
    D[..., 1, 1], D[..., 1, 2] = fy / z, -fy * X_cam[..., 1] / z**2
    A = (D @ T[:, None, :3, :3] @ J) / seen.noise[..., None, None]
    n, size = len(X), J.shape[-1]
    weighted = (A * weight[..., None, None]).reshape(n, 42, size)
    H = np.swapaxes(weighted, 1, 2) @ A.reshape(n, 42, size)
    g = (r.reshape(n, 1, 42) @ weighted)[:, 0]
    costs = OUTLIER**2 * np.sum(seen.there * np.log1p(np.sum(r * r, axis=-1) / OUTLIER**2), axis=1)
    return costs, H, g


def _place(chains: Chains, seen: Seen, grasp: Float[ndarray, "5 3 3"]) -> Float[ndarray, "n 4 4"]:
    """T_cam_hand of each frame for a hand that is stiff, from the best of many rotations."""
    n, m = len(seen.y), ROTATIONS
    X, J = joints_and_jacobian(chains, np.tile(grasp, (n, 1, 1, 1)), np.zeros(chains.directions.shape[-1]))
    R = se3.super_fibonacci(m)
    T = np.tile(np.eye(4), (n, m, 1, 1))
    for k in range(n):
        there = seen.there[k]
        distance = seen.K[0, 0] * _spread(X[k][there]) / _spread(seen.y[k][there])
        middle = backproject(seen.K, seen.y[k][there].mean(axis=0)[None])[0] * distance
        T[k] = se3.rigid(R, middle - (R @ X[k][there].mean(axis=0)))
    many = Seen(seen.K, *(np.repeat(each, m, axis=0) for each in seen[1:]))
    T, X, J = T.reshape(n * m, 4, 4), np.repeat(X, m, axis=0), np.repeat(J[..., :6], m, axis=0)
    cost, H, g = _each_frame(many, T, X, J)
    damping = np.full(n * m, 1e-2)
    for _ in range(PLACING_STEPS):
        A = H + (damping[:, None] * np.einsum("nii->ni", H) + 1e-9)[:, None] * np.eye(6)
        new = turned(T, -np.linalg.solve(A, g[..., None])[..., 0], chains.wrist)
        new_cost, new_H, new_g = _each_frame(many, new, X, J)
        better = new_cost < cost
        T[better], cost[better], H[better], g[better] = new[better], new_cost[better], new_H[better], new_g[better]
        damping = np.where(better, damping / 10.0, damping * 10.0)
    best = cost.reshape(n, m).argmin(axis=1)
    return T.reshape(n, m, 4, 4)[np.arange(n), best]


def between(
    keys: Sequence[int], T: Float[ndarray, "n 4 4"], q: Float[ndarray, "n 5 3 3"], first: int, last: int
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 5 3 3"]]:
    """Hands in all frames: smooth through those of the keys, at rest beyond them.

    Positions go along straight rays' pixels and log depths (so that a hand in view stays in view), fingers along
    monotone cubic splines, rotations along a spline of continuous acceleration.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, RotationSpline

    count = last - first + 1
    if len(keys) == 1:
        return np.repeat(T, count, axis=0), np.repeat(q, count, axis=0)
    at = np.clip(np.arange(first, last + 1), keys[0], keys[-1])
    R = RotationSpline(keys, Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix()
    t = T[:, :3, 3]
    seen = np.column_stack([t[:, :2] / t[:, 2:], np.log(t[:, 2])])
    u, v, log_z = PchipInterpolator(keys, seen)(at).T
    z = np.exp(log_z)
    return se3.rigid(R, np.column_stack([u * z, v * z, z])), PchipInterpolator(keys, q)(at)


def model_pose(q: Float[ndarray, "T 5 3 3"]) -> Float[ndarray, "T 45"]:
    """The fingers' rotation vectors in the order of the model's joints."""
    pose = np.zeros((len(q), 45))
    for n, knuckle in enumerate(KNUCKLES):
        pose[:, 3 * knuckle - 3 : 3 * knuckle + 6] = q[:, n].reshape(len(q), 9)
    return pose
