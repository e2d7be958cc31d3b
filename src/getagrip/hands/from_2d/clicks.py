"""Fit the generic hand in every frame to joints clicked on a few frames: one shape, one grasp.

The fit minimises, over the shape b, the grasp g, and for each clicked frame n the pose q_n and the rigid motion T_n,

    sum_n,i rho(|project(K, T_n X_i(b, q_n)) - y_n,i| / noise_n,i) + sum_n |q_n - g|^2 / LOOSENESS^2
        + |prior(g)|^2 + |b / spread|^2

by Levenberg-Marquardt on the block-arrow normal equations of ``hands.fit_joints``, with rho(r) = c^2 log(1 + r^2 / c^2)
(Cauchy), so that a few wrong clicks count little. The fingers of a grasping hand hardly move: joints hidden in one
frame are known from the others.

One view determines neither the size of a hand nor its distance. The size is assumed, the generic hand's, and the
distance follows from it. Between clicked frames the hand moves smoothly; before the first and after the last it rests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.read_arrays import MAX_CAMERA_RANGE_M, MIN_CAMERA_RANGE_M
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import (
    Chains,
    Equations,
    PosePrior,
    apply_hand_step,
    descend,
    joints_and_jacobian,
    model_pose,
)
from getagrip.hands.from_2d.rigid_pnp import (
    CLICK_OUTLIER_SIGMAS,
    Clicks,
    OcclusionDistances,
    click_equations,
    place_rigid_hands,
    turning_cost,
)
from getagrip.hands.model import HandModel, Side, hand_track

ASSUMED_SCALE_NOTE = "a guess: the generic hand has the size of a mean one, and its distance follows from that"

MIN_CLICKED_JOINTS = 6
"""Minimum number of joints clicked on a frame."""
MIN_CLICK_EXTENT_PX = 10.0
"""Minimum extent of a frame's clicks [px]."""
GRASP_POSE_SIGMA_RAD = 0.12
"""Standard deviation of each pose parameter of the fingers from the grasp's [rad]."""
INITIAL_CURLS_RAD = ((0.3, 0.3, 0.3), (0.9, 0.6, 0.4))
"""Initial bends of the fingers, from knuckle to fingertip [rad]; the best fit counts."""
MAX_PLACEMENT_ITERATIONS = 4
"""Maximum number of rounds of placing hands and fitting them."""
MAX_CLICK_STEPS = 60
COST_TOLERANCE = 1e-5
"""Relative decrease of the cost below which the rounds end."""
N_GRASP_PARAMETERS = 45
"""Number of grasp parameters, after the 51 of each frame and before the shape's."""


@dataclass(frozen=True)
class ClickedHands:
    """A hand in every frame, fitted to clicks on n of them.

    Attributes:
        hand: the hand in each frame from the first to the last.
        keys: the clicked frames.
        residuals: (n, 21) distance of each fitted joint from its click [px]; NaN without a click.
        outliers: (n, 21) clicks beyond ``CLICK_OUTLIER_SIGMAS``.
        shape: (S,) shape parameters.
    """

    hand: HandTrack
    keys: tuple[int, ...]
    residuals: Float[ndarray, "n 21"]
    outliers: Bool[ndarray, "n 21"]
    shape: Float[ndarray, "S"]


def hands_from_clicks(
    clicks: Mapping[int, Float[ndarray, "..."]], K: Float[ndarray, "3 3"], side: Side, first: int, last: int
) -> ClickedHands:
    """Fit the hand in the frames ``first`` to ``last``, both included, to joints clicked on some of them [px].

    ``clicks`` (21, 2) are wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip, NaN where not
    clicked. Raises ``UsageError`` for no clicked frame, for one with fewer than ``MIN_CLICKED_JOINTS`` joints or
    outside the interval, and for clicks that no hand fits.
    """
    _check_clicks(clicks, first, last)
    keys = tuple(sorted(clicks))
    value = Clicks.of(K, np.array([clicks[n] for n in keys], dtype=float))
    model = generic.load(side)
    chains, prior = Chains.of(model), PosePrior.of(model)
    fit = ClickFit(model, chains, prior, value)
    found = fit_clicked_hands(fit)
    check_found(keys, found)
    residuals = fit.residuals(found)
    outliers = value.there & (residuals > CLICK_OUTLIER_SIGMAS * value.noise)
    T, q = interpolate_key_hands(keys, found.T, found.q, first, last)
    posed = model.with_shape(found.shape).with_pose(model_pose(q))
    seen = np.zeros((len(T), 21, 3))
    seen[np.array(keys) - first] = np.concatenate([value.y, value.there[..., None]], axis=-1)
    hand = replace(hand_track(posed, T), joints_2d=seen[..., :2], joints_2d_confidence=seen[..., 2])
    return ClickedHands(hand, keys, residuals, outliers, found.shape)


def _check_clicks(clicks: Mapping[int, Float[ndarray, "..."]], first: int, last: int) -> None:
    if not clicks:
        raise UsageError("missing joints: one frame at least needs some")
    for n, points in clicks.items():
        if not first <= n <= last:
            raise UsageError(f"joints must be on frames {first} to {last} (got some on frame {n})")
        if np.shape(points) != (21, 2) or np.isinf(points).any():
            raise UsageError(f"joints of frame {n} must be finite, of shape (21, 2) (got {np.shape(points)})")
        count = int(np.count_nonzero(~np.isnan(points).any(axis=1)))
        if count < MIN_CLICKED_JOINTS:
            raise UsageError(f"joints of frame {n} must be {MIN_CLICKED_JOINTS} at least, or none (got {count})")
        extent = float(np.max(np.nanmax(points, axis=0) - np.nanmin(points, axis=0)))
        if extent < MIN_CLICK_EXTENT_PX:
            got = f"all within {extent:.3g} px"
            raise UsageError(f"joints of frame {n} must be {MIN_CLICK_EXTENT_PX:g} px apart or more (got {got})")


def check_found(keys: Sequence[int], found: ClickUnknowns) -> None:
    """Raise ``UsageError`` for an impossible fit: outside the camera's range, or with a joint turned by over pi."""
    for n, T, q in zip(keys, found.T, found.q, strict=True):
        if not MIN_CAMERA_RANGE_M < T[2, 3] < MAX_CAMERA_RANGE_M or np.abs(q).max() > np.pi:
            raise UsageError(f"joints of frame {n}: no hand looks like that; is the side right, and each joint's name?")


class ClickUnknowns(NamedTuple):
    """The unknowns of the fit."""

    T: Float[ndarray, "n 4 4"]
    """T_cam_hand."""
    q: Float[ndarray, "n 5 3 3"]
    """Rotation vectors of the fingers' joints."""
    grasp: Float[ndarray, "1 5 3 3"]
    """Prior mean of all q."""
    shape: Float[ndarray, "S"]
    wrist: Float[ndarray, "3"]
    """Wrist of the mean hand, the centre of rotations."""

    def retract(self, frames: Float[ndarray, "n 51"], shared: Float[ndarray, "s"]) -> ClickUnknowns:
        """Apply a step (``apply_hand_step``); poses, grasp and shape add up."""
        return self._replace(
            T=apply_hand_step(self.T, frames[:, :6], self.wrist),
            q=self.q + frames[:, 6:].reshape(self.q.shape),
            grasp=self.grasp + shared[:N_GRASP_PARAMETERS].reshape(self.grasp.shape),
            shape=self.shape + shared[N_GRASP_PARAMETERS:],
        )


class ClickFit(NamedTuple):
    """The fit: hand model, observations and their weights."""

    model: HandModel
    chains: Chains
    prior: PosePrior
    clicks: Clicks
    looseness: float = GRASP_POSE_SIGMA_RAD
    """Standard deviation of each pose parameter of the fingers from the grasp's [rad]."""
    repeats: float = 1.0
    """Number of frames with the same errors, which count as one frame for the shared parameters."""
    hiding: OcclusionDistances | None = None
    """Distances from pixels that can hide joints; None: all can."""

    def equations(self, guess: ClickUnknowns) -> Equations:
        """Compute the cost, and per frame J^T J and J^T r of (T_cam_hand step, pose, grasp, shape)."""
        n, S = len(self.clicks.y), len(guess.shape)
        X, J_hand = joints_and_jacobian(self.chains, guess.q, guess.shape)
        J = np.zeros((n, 21, 3, 51 + N_GRASP_PARAMETERS + S))
        J[..., :51], J[..., 51 + N_GRASP_PARAMETERS :] = J_hand[..., :51], J_hand[..., 51:]
        costs, H, g = click_equations(self.clicks, guess.T, X, J)
        if self.hiding is not None:
            hidden = self.hiding.equations(self.clicks.K, self.clicks.noise, guess.T, X, J)
            costs, H, g = costs + hidden[0], H + hidden[1], g + hidden[2]
        i = np.arange(45)
        off = (guess.q - guess.grasp).reshape(n, 45) / self.looseness
        for at, sign in ((6, 1.0), (51, -1.0)):
            H[:, at + i, at + i] += 1.0 / self.looseness**2
            H[:, at + i, 57 - at + i] -= 1.0 / self.looseness**2
            g[:, at + i] += sign * off / self.looseness
        # The priors of shared parameters are divided among the frames, so that their sum has them once.
        p, P = self.prior.residuals(guess.grasp)
        b, share = guess.shape / self.model.shape_spread, self.repeats / n
        H[:, 51:96, 51:96] += share * P[0].T @ P[0]
        g[:, 51:96] += share * p[0] @ P[0]
        H[:, 96:, 96:] += share * np.diag(1.0 / self.model.shape_spread**2)
        g[:, 96:] += share * b / self.model.shape_spread
        return float(np.sum(costs) + np.sum(off**2) + self.repeats * (np.sum(p**2) + b @ b)), H, g

    def residuals(self, guess: ClickUnknowns) -> Float[ndarray, "n 21"]:
        """Compute the distance of each joint from its click [px]; NaN without a click."""
        X, _ = joints_and_jacobian(self.chains, guess.q, guess.shape)
        off = project(self.clicks.K, se3.transform(guess.T, X)) - self.clicks.y
        return np.where(self.clicks.there, np.linalg.norm(off, axis=-1), np.nan)

    def near(self, guess: ClickUnknowns) -> tuple[ClickUnknowns, float]:
        """Fit the hands, starting at a guess; also return their cost."""
        found, cost, _ = descend(guess, self.equations, MAX_CLICK_STEPS)
        return found, cost


def fit_clicked_hands(fit: ClickFit) -> ClickUnknowns:
    """Fit the hands from each of ``INITIAL_CURLS_RAD``, and return the best fit."""
    return min((_fit_from_curl(fit, curl) for curl in INITIAL_CURLS_RAD), key=lambda each: each[1])[0]


def _fit_from_curl(fit: ClickFit, curl: tuple[float, float, float]) -> tuple[ClickUnknowns, float]:
    """Fit the hands from fingers bent by ``curl`` [rad]; also return their cost.

    A fit improves the fingers, so that the hands are placed and fitted again as long as the cost decreases.
    """
    prior, chains = fit.prior, fit.chains
    grasp, shape = prior.mean.copy(), np.zeros(len(fit.model.shape_names))
    grasp[1:] = np.array(curl)[:, None] * prior.axes[1:, :, 1]
    best, cost = None, np.inf
    for _ in range(MAX_PLACEMENT_ITERATIONS):
        T = place_rigid_hands(chains, fit.clicks, grasp, shape)
        guess = ClickUnknowns(T, np.tile(grasp, (len(T), 1, 1, 1)), grasp[None], shape, chains.wrist)
        found, new_cost = fit.near(guess)
        new_cost += float(turning_cost(found.T[:-1, :3, :3], found.T[1:, :3, :3]).sum())
        if best is not None and new_cost > (1.0 - COST_TOLERANCE) * cost:
            break
        best, cost, grasp, shape = found, new_cost, found.grasp[0], found.shape
    assert best is not None
    return best, cost


def interpolate_key_hands(
    keys: Sequence[int], T: Float[ndarray, "n 4 4"], q: Float[ndarray, "n 5 3 3"], first: int, last: int
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 5 3 3"]]:
    """Interpolate hands smoothly from the key frames to all frames; before the first and after the last they rest.

    Positions are interpolated in pixels and log depth (so that a hand in view stays in view) and fingers by monotone
    cubic splines, rotations by a spline of continuous acceleration.
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
