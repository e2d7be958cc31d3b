"""Place rigid hands by clicked joints (perspective-n-point): the clicks, their robust cost, and the search for poses.

The cost of a click at r standard deviations from its joint is c^2 log(1 + r^2 / c^2) (Cauchy), so that a few wrong
clicks count little.

Hidden joints: they are behind the object or the hand itself, not in front of the background.

A joint away from all pixels of hand and object would be visible. So each joint costs its distance from the pixels that
can hide it, by the same robust cost as a click (``rigid_pnp``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import backproject, project
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_SIGMA_M, Chains, apply_hand_step, joints_and_jacobian
from getagrip.least_squares import DampingRules, damp_hessian, minimise

CLICK_SIGMA_M = 0.005
"""Standard deviation of a click, in addition to the joints' own, at the hand [m]."""
JOINT_DEPTH_SIGMA_M = 0.025
"""Standard deviation of a network's depths of joints about a plane [m]."""
COLLINEAR_RIDGE = 1e-3
"""Ridge of the plane fit, for collinear joints, as a fraction of their variance in the image."""
CLICK_OUTLIER_SIGMAS = 2.5
"""Number of standard deviations beyond which a click is an outlier."""
N_PLACEMENT_ROTATIONS = 48
"""Number of initial rotations, uniform over SO(3)."""
N_PLACEMENT_STEPS = 12
"""Number of steps from each rotation."""
PLACEMENT_RULES = DampingRules(success=0.1, failure=10.0, least=0.0, most=np.inf, rejections=np.inf, tolerance=0.0)
"""No early convergence: all hands take all steps."""
TURN_SIGMA_RAD = 0.7
"""Standard deviation of a hand's rotation between consecutive clicked frames [rad]."""


class Clicks(NamedTuple):
    """Joints clicked on n frames.

    Attributes:
        K: (3, 3) intrinsics [px].
        y: (n, 21, 2) positions [px]; zero where not clicked.
        there: (n, 21) whether each joint is clicked.
        noise: (n, 21) standard deviation of each click [px].
        depth: (n, 21) depth of each joint along the ray to the hand, up to a plane over the image [m].
        depth_known: (n,) frames with depths.
    """

    K: Float[ndarray, "3 3"]
    y: Float[ndarray, "n 21 2"]
    there: Bool[ndarray, "n 21"]
    noise: Float[ndarray, "n 21"]
    depth: Float[ndarray, "n 21"]
    depth_known: Bool[ndarray, "n"]

    @staticmethod
    def of(K: Float[ndarray, "3 3"], points: Float[ndarray, "n 21 2"]) -> Clicks:
        """Make clicks of ``points`` [px], NaN where not clicked; their noise follows from the hand's extent."""
        there = ~np.isnan(points).any(axis=-1)
        flat = generic.load("right").with_shape().with_pose().joints
        pairs = zip(points, there, strict=True)
        per_metre = np.array([_mean_radius(y[seen]) / _mean_radius(flat[seen]) for y, seen in pairs])
        noise = per_metre[:, None] * np.hypot(JOINT_SIGMA_M, CLICK_SIGMA_M)
        none = np.zeros(len(points), dtype=bool)
        return Clicks(K, np.where(there[..., None], points, 0.0), there, noise, np.zeros(there.shape), none)


def _mean_radius(points: Float[ndarray, "n d"]) -> float:
    """Compute the mean distance from the centroid, at least 1e-6."""
    return max(float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean()), 1e-6)


def click_equations(
    clicks: Clicks, T: Float[ndarray, "n 4 4"], X: Float[ndarray, "n 21 3"], J: Float[ndarray, "n 21 3 D"]
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
    """Compute each frame's cost, J^T J and J^T r, with the derivatives J of the joints X in the hand's axes."""
    uv, by_joint = project_hand_joints(clicks.K, T, X, J)
    r = (uv - clicks.y) / clicks.noise[..., None]
    weight = clicks.there / (1.0 + np.sum(r * r, axis=-1) / CLICK_OUTLIER_SIGMAS**2)  # of Cauchy's rho, for J^T J
    A = by_joint / clicks.noise[..., None, None]
    n, size = len(X), J.shape[-1]
    weighted = (A * weight[..., None, None]).reshape(n, 42, size)
    H = np.swapaxes(weighted, 1, 2) @ A.reshape(n, 42, size)
    g = (r.reshape(n, 1, 42) @ weighted)[:, 0]
    costs = CLICK_OUTLIER_SIGMAS**2 * np.sum(
        clicks.there * np.log1p(np.sum(r * r, axis=-1) / CLICK_OUTLIER_SIGMAS**2), axis=1
    )
    if clicks.depth_known.any():
        _add_depth_equations(clicks, T, X, J, uv, costs, H, g)
    return costs, H, g


def project_hand_joints(
    K: Float[ndarray, "3 3"], T: Float[ndarray, "n 4 4"], X: Float[ndarray, "n 21 3"], J: Float[ndarray, "n 21 3 D"]
) -> tuple[Float[ndarray, "n 21 2"], Float[ndarray, "n 21 2 D"]]:
    """Project joints [px] and their derivatives J in the hand's axes."""
    X_cam = se3.transform(T, X)
    z = np.maximum(X_cam[..., 2], 0.01)  # behind the camera the cost is large, and cannot be fitted
    X_cam = np.concatenate([X_cam[..., :2], z[..., None]], axis=-1)
    D = np.zeros((*z.shape, 2, 3))
    D[..., 0, 0], D[..., 0, 2] = K[0, 0] / z, -K[0, 0] * X_cam[..., 0] / z**2
    D[..., 1, 1], D[..., 1, 2] = K[1, 1] / z, -K[1, 1] * X_cam[..., 1] / z**2
    return project(K, X_cam), D @ T[:, None, :3, :3] @ J


def _add_depth_equations(
    clicks: Clicks,
    T: Float[ndarray, "n 4 4"],
    X: Float[ndarray, "n 21 3"],
    J: Float[ndarray, "n 21 3 D"],
    uv: Float[ndarray, "n 21 2"],
    costs: Float[ndarray, "n"],
    H: Float[ndarray, "n D D"],
    g: Float[ndarray, "n D"],
) -> None:
    """Add the equations of joints' depths, up to a plane: a network's hands are rotated as a whole."""
    rows = clicks.depth_known
    ray = np.einsum("ni,nij->nj", _rays(clicks)[rows], T[rows, :3, :3])[:, None]
    off, A = np.sum(X[rows] * ray, axis=-1), (ray[:, :, None] @ J[rows])[:, :, 0]
    r = _subtract_plane(uv[rows], (off - clicks.depth[rows])[..., None])[..., 0] / JOINT_DEPTH_SIGMA_M
    A = _subtract_plane(uv[rows], A) / JOINT_DEPTH_SIGMA_M
    weighted = A / (1.0 + r[..., None] ** 2 / CLICK_OUTLIER_SIGMAS**2)
    costs[rows] += CLICK_OUTLIER_SIGMAS**2 * np.sum(np.log1p(r * r / CLICK_OUTLIER_SIGMAS**2), axis=1)
    H[rows] += np.swapaxes(weighted, 1, 2) @ A
    g[rows] += (r[:, None] @ weighted)[:, 0]


def _subtract_plane(uv: Float[ndarray, "n 21 2"], values: Float[ndarray, "n 21 D"]) -> Float[ndarray, "n 21 D"]:
    """Subtract the best-fitting plane over the image."""
    centred, apart = (each - each.mean(axis=1, keepdims=True) for each in (values, uv))
    across = np.swapaxes(apart, 1, 2)
    G = across @ apart
    ridge = COLLINEAR_RIDGE * np.trace(G, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    return np.asarray(centred - apart @ np.linalg.solve(G + ridge, across @ centred))


def _rays(clicks: Clicks) -> Float[ndarray, "n 3"]:
    """Return unit vectors towards the hands' centroids."""
    count = np.maximum(clicks.there.sum(axis=1), 1)[:, None]
    ray = backproject(clicks.K, clicks.y.sum(axis=1) / count)
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def place_rigid_hands(
    chains: Chains, clicks: Clicks, grasp: Float[ndarray, "5 3 3"], shape: Float[ndarray, "S"]
) -> Float[ndarray, "n 4 4"]:
    """Return T_cam_hand of rigid hands with fingers bent as in ``grasp``: they fit and turn little between frames."""
    n, m = len(clicks.y), N_PLACEMENT_ROTATIONS
    X, J = joints_and_jacobian(chains, grasp[None], shape)
    R = se3.super_fibonacci(m)
    T = np.tile(np.eye(4), (n, m, 1, 1))
    for k, there in enumerate(clicks.there):
        distance = clicks.K[0, 0] * _mean_radius(X[0, there]) / _mean_radius(clicks.y[k, there])
        middle = backproject(clicks.K, clicks.y[k, there].mean(axis=0)[None])[0] * distance
        T[k] = se3.rigid(R, middle - R @ X[0, there].mean(axis=0))
    many = Clicks(clicks.K, *(np.repeat(each, m, axis=0) for each in clicks[1:]))
    rigid = _RigidHands(np.repeat(X, n * m, axis=0), np.repeat(J[..., :6], n * m, axis=0), many, chains.wrist)
    found = minimise(rigid.at(T.reshape(n * m, 4, 4)), N_PLACEMENT_STEPS, PLACEMENT_RULES).state
    T = found.T.reshape(n, m, 4, 4)
    return T[np.arange(n), _smoothest(found.cost.reshape(n, m), T[..., :3, :3])]


class _RigidHands(NamedTuple):
    """Hands with fixed fingers, each with its clicks."""

    X: Float[ndarray, "k 21 3"]
    J: Float[ndarray, "k 21 3 6"]
    clicks: Clicks
    wrist: Float[ndarray, "3"]

    def at(self, T: Float[ndarray, "k 4 4"]) -> _Placed:
        return _Placed(self, T, *click_equations(self.clicks, T, self.X, self.J))


class _Placed(NamedTuple):
    """Poses of rigid hands (``least_squares.State``); each step tries all."""

    rigid: _RigidHands
    T: Float[ndarray, "k 4 4"]
    cost: Float[ndarray, "k"]
    H: Float[ndarray, "k 6 6"]
    g: Float[ndarray, "k 6"]

    def trial(self, active: Int[ndarray, "k"], damping: Float[ndarray, "k"]) -> _Placed:
        step = -np.linalg.solve(damp_hessian(self.H, damping, floor=1e-6), self.g[..., None])[..., 0]
        return self.rigid.at(apply_hand_step(self.T, step, self.rigid.wrist))

    def accept(self, trial: _Placed, active: Int[ndarray, "k"], better: Bool[ndarray, "k"]) -> _Placed:
        pairs = zip(trial[1:], self[1:], strict=True)
        kept = (np.where(better.reshape(-1, *[1] * (old.ndim - 1)), new, old) for new, old in pairs)
        return _Placed(self.rigid, *kept)


def turning_cost(Ra: Float[ndarray, "*#batch 3 3"], Rb: Float[ndarray, "*#batch 3 3"]) -> Float[ndarray, "*batch"]:
    """Compute the cost of a rotation between consecutive clicked frames."""
    return np.asarray((se3.angle_between(Ra, Rb) / TURN_SIGMA_RAD) ** 2)


def _smoothest(cost: Float[ndarray, "n m"], R: Float[ndarray, "n m 3 3"]) -> Int[ndarray, "n"]:
    """Choose one of m rotations in each frame with the least sum of their costs and turning costs (Viterbi)."""
    total, came = cost[0], []
    for k in range(1, len(cost)):
        both = total[:, None] + turning_cost(R[k - 1][:, None], R[k][None])
        came.append(both.argmin(axis=0))
        total = both.min(axis=0) + cost[k]
    path = [int(total.argmin())]
    for before in came[::-1]:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1])


MAX_DISTANCE_IMAGE_PX = 320
"""Maximum side of the images of distances [px]."""


class OcclusionDistances(NamedTuple):
    """Distances from the pixels that show a hand or can hide it, in n frames."""

    distance: Float32[ndarray, "m h w"]
    """Distance of each pixel [px of the video]; zero in frames without masks."""
    rows: Int[ndarray, "n"]
    """The frames' places in ``distance``, which may be hundreds of megabytes: some of its frames are no copy."""
    zoom: float
    """Pixels of ``distance`` per pixel of the video."""

    @staticmethod
    def of(possible: Bool[ndarray, "n h w"], zoom: float) -> OcclusionDistances:
        """Measure distances from the ``possible`` pixels, in images scaled by ``zoom``."""
        import cv2

        distance = np.zeros(possible.shape, np.float32)
        for out, each in zip(distance, possible, strict=True):
            if each.any():
                out[:] = cv2.distanceTransform((~each).astype(np.uint8), cv2.DIST_L2, 5) / zoom
        return OcclusionDistances(distance, np.arange(len(distance)), zoom)

    def take(self, rows: ndarray) -> OcclusionDistances:
        """Return the distances of some frames."""
        return self._replace(rows=self.rows[rows])

    def at(self, uv: Float[ndarray, "n k 2"]) -> tuple[Float[ndarray, "n k"], Float[ndarray, "n k 2"]]:
        """Return the distance at points [px], and its derivative; both zero outside the image."""
        h, w = self.distance.shape[1:]
        if not (len(self.rows) and h > 1 and w > 1):
            return np.zeros(uv.shape[:2]), np.zeros(uv.shape)
        x, y = np.moveaxis(np.nan_to_num(uv * self.zoom - 0.5, posinf=-2.0, neginf=-2.0), -1, 0)
        inside = (x > 0.0) & (x < w - 1.0) & (y > 0.0) & (y < h - 1.0)
        i, j = (np.clip(np.floor(v), 0, size - 2).astype(int) for v, size in ((x, w), (y, h)))
        a, b = np.where(inside, x - i, 0.0), np.where(inside, y - j, 0.0)
        row = self.rows[:, None]
        p, q, r, s = (self.distance[row, j + dy, i + dx] for dy in (0, 1) for dx in (0, 1))
        value = (1.0 - b) * ((1.0 - a) * p + a * q) + b * ((1.0 - a) * r + a * s)
        slope = np.stack([(1.0 - b) * (q - p) + b * (s - r), (1.0 - a) * (r - p) + a * (s - q)], axis=-1)
        return np.where(inside, value, 0.0), self.zoom * np.where(inside[..., None], slope, 0.0)

    def equations(
        self,
        K: Float[ndarray, "3 3"],
        noise: Float[ndarray, "n 21"],
        T: Float[ndarray, "n 4 4"],
        X: Float[ndarray, "n 21 3"],
        J: Float[ndarray, "n 21 3 D"],
    ) -> tuple[Float[ndarray, "n"], Float[ndarray, "n D D"], Float[ndarray, "n D"]]:
        """Compute each frame's cost, J^T J and J^T r, as ``click_equations`` does for clicks."""
        uv, by_joint = project_hand_joints(K, T, X, J)
        off, slope = self.at(uv)
        r = off / noise
        A = (slope[..., None, :] @ by_joint)[..., 0, :] / noise[..., None]
        weighted = A / (1.0 + r * r / CLICK_OUTLIER_SIGMAS**2)[..., None]
        costs = CLICK_OUTLIER_SIGMAS**2 * np.sum(np.log1p(r * r / CLICK_OUTLIER_SIGMAS**2), axis=1)
        return costs, np.swapaxes(weighted, 1, 2) @ A, (r[:, None] @ weighted)[:, 0]
