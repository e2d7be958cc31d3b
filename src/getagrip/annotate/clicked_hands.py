"""From joints clicked on a few frames to a hand in every frame: the generic hand, one shape, one way to hold.

Minimised is, over the shape b, the grasp g, and for each clicked frame n the pose q_n and the rigid motion T_n,

    sum_n,i rho(|project(K, T_n X_i(b, q_n)) - y_n,i| / noise_n,i) + sum_n |q_n - g|^2 / LOOSENESS^2
        + |prior(g)|^2 + |b / spread|^2

by Levenberg-Marquardt on the block-arrow normal equations of ``hands.fit``, with rho(r) = c^2 log(1 + r^2 / c^2)
(Cauchy), so that a few wrong clicks count little. The fingers of a hand that holds something hardly move: joints that
are hidden in one frame are known from the others.

One view determines neither the size of a hand nor its distance. The size is that of the generic hand, a guess, and the
distance follows from it. Between clicked frames the hand moves smoothly; before the first and after the last it stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.annotate.placed_hands import OUTLIER, Clicks, equations, place, turning
from getagrip.clip import HandTrack
from getagrip.clip.plausible import FARTHEST, NEAREST
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.descent import Equations, descend
from getagrip.hands.fit import Chains, joints_and_jacobian, stepped
from getagrip.hands.model import KNUCKLES, HandModel, Side, hand_track
from getagrip.hands.pose_prior import PosePrior

SCALE = "a guess: the generic hand has the size of a mean one, and its distance follows from that"

FEWEST = 6
"""Joints that a frame must have."""
SMALLEST = 10.0
"""Extent of the clicks of a frame [px]."""
LOOSENESS = 0.12
"""Standard deviation of each number of the fingers' pose from that of the grasp [rad]."""
CURLS = ((0.3, 0.3, 0.3), (0.9, 0.6, 0.4))
"""Bends of the fingers that are tried at first, from knuckle to fingertip [rad]."""
ROUNDS = 4
"""Of placing hands and fitting them."""
STEPS = 60
TOLERANCE = 1e-5
"""Stop when a round lowers the cost by less than this share of it."""
SHARED = 45
"""Numbers of the grasp, after the frames' 51 and before the shape."""

Curl = tuple[float, float, float]


@dataclass(frozen=True)
class ClickedHands:
    """A hand in every frame, fitted to clicks on some of them."""

    hand: HandTrack
    """In each frame from the first to the last."""
    keys: tuple[int, ...]
    """The frames that were clicked."""
    residuals: Float[ndarray, "n 21"]
    """Distance of each fitted joint from its click [px]; NaN where there is none."""
    outliers: Bool[ndarray, "n 21"]
    """Clicks that do not fit the others."""
    shape: Float[ndarray, "S"]


def hands_from_clicks(
    clicks: Mapping[int, Float[ndarray, "..."]], K: Float[ndarray, "3 3"], side: Side, first: int, last: int
) -> ClickedHands:
    """The hand in the frames ``first`` to ``last``, both included, from joints clicked on some of them [px].

    ``clicks`` (21, 2) are wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip, NaN where not
    clicked. Raises ``UsageError`` for no clicked frame, for one with fewer than ``FEWEST`` joints or outside the
    interval, and for clicks that no hand looks like.
    """
    _check(clicks, first, last)
    keys = tuple(sorted(clicks))
    value = Clicks.of(K, np.array([clicks[n] for n in keys], dtype=float))
    model = generic.load(side)
    chains, prior = Chains.of(model), PosePrior.of(model)
    found = min((_fit(model, chains, prior, value, curl) for curl in CURLS), key=lambda each: each[1])[0]
    _check_found(keys, found)
    X, _ = joints_and_jacobian(chains, found.q, found.shape)
    offset = project(K, se3.transform(found.T, X)) - value.y
    residuals = np.where(value.there, np.linalg.norm(offset, axis=-1), np.nan)
    outliers = value.there & (residuals > OUTLIER * value.noise)
    T, q = between(keys, found.T, found.q, first, last)
    posed = model.with_shape(found.shape).with_pose(model_pose(q))
    return ClickedHands(hand_track(posed, T), keys, residuals, outliers, found.shape)


def _check(clicks: Mapping[int, Float[ndarray, "..."]], first: int, last: int) -> None:
    if not clicks:
        raise UsageError("missing joints: one frame at least needs some")
    for n, points in clicks.items():
        if not first <= n <= last:
            raise UsageError(f"joints must be on frames {first} to {last} (got some on frame {n})")
        if np.shape(points) != (21, 2) or np.isinf(points).any():
            raise UsageError(f"joints of frame {n} must be finite, of shape (21, 2) (got {np.shape(points)})")
        count = int(np.count_nonzero(~np.isnan(points).any(axis=1)))
        if count < FEWEST:
            raise UsageError(f"joints of frame {n} must be {FEWEST} at least, or none (got {count})")
        extent = float(np.max(np.nanmax(points, axis=0) - np.nanmin(points, axis=0)))
        if extent < SMALLEST:
            raise UsageError(
                f"joints of frame {n} must be {SMALLEST:g} px apart or more (got all within {extent:.3g} px)"
            )


def _check_found(keys: Sequence[int], found: Guess) -> None:
    """Raise ``UsageError`` where clicks led to no hand."""
    for n, T, q in zip(keys, found.T, found.q, strict=True):
        if not NEAREST < T[2, 3] < FARTHEST or np.abs(q).max() > np.pi:
            raise UsageError(f"joints of frame {n}: no hand looks like that; is the side right, and each joint's name?")


class Guess(NamedTuple):
    """What is sought."""

    T: Float[ndarray, "n 4 4"]
    """T_cam_hand."""
    q: Float[ndarray, "n 5 3 3"]
    """Rotation vectors of the fingers' joints."""
    grasp: Float[ndarray, "1 5 3 3"]
    """What all q are near to."""
    shape: Float[ndarray, "S"]

    wrist: Float[ndarray, "3"]
    """Of the mean hand, which rotations are about."""

    def retract(self, frames: Float[ndarray, "n 51"], shared: Float[ndarray, "s"]) -> Guess:
        """After a step: each hand shifts in its own axes and turns about the wrist, the rest adds up."""
        return self._replace(
            T=stepped(self.T, frames[:, :6], self.wrist),
            q=self.q + frames[:, 6:].reshape(self.q.shape),
            grasp=self.grasp + shared[:SHARED].reshape(self.grasp.shape),
            shape=self.shape + shared[SHARED:],
        )


def _fit(model: HandModel, chains: Chains, prior: PosePrior, clicks: Clicks, curl: Curl) -> tuple[Guess, float]:
    """The best hands from fingers that are bent by ``curl``, and their cost.

    After a fit the orientation of the hands is known better: they are placed and fitted anew
    as long as that helps.
    """
    grasp, shape = prior.mean.copy(), np.zeros(len(model.shape_names))
    grasp[1:] = np.array(curl)[:, None] * prior.axes[1:, :, 1]
    best, cost = None, np.inf
    for _ in range(ROUNDS):
        T = place(chains, clicks, grasp, shape)
        start = Guess(T, np.tile(grasp, (len(T), 1, 1, 1)), grasp[None], shape, chains.wrist)
        found, new_cost, _ = descend(start, lambda at: _normal_equations(model, chains, prior, at, clicks), STEPS)
        new_cost += float(turning(found.T[:-1, :3, :3], found.T[1:, :3, :3]).sum())
        if best is not None and new_cost > (1.0 - TOLERANCE) * cost:
            break
        best, cost, grasp, shape = found, new_cost, found.grasp[0], found.shape
    assert best is not None
    return best, cost


def _normal_equations(model: HandModel, chains: Chains, prior: PosePrior, guess: Guess, clicks: Clicks) -> Equations:
    """The cost, and per frame J^T J and J^T r of (T_cam_hand step, pose, grasp, shape)."""
    n, S = len(clicks.y), len(guess.shape)
    X, J_hand = joints_and_jacobian(chains, guess.q, guess.shape)
    J = np.zeros((n, 21, 3, 51 + SHARED + S))
    J[..., :51], J[..., 51 + SHARED :] = J_hand[..., :51], J_hand[..., 51:]
    costs, H, g = equations(clicks, guess.T, X, J)
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
    return float(np.sum(costs) + np.sum(off**2) + np.sum(p**2) + b @ b), H, g


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
