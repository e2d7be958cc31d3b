"""An object's motion in the hand approximated by one pose, or by a rotation about one axis (paper, Eq. 3 and 4).

Poses are rotations R_n (object to hand) and positions c_n of the object's centre in the hand frame. The paper's
``||T_n - T_gt,n||^2`` adds rotations to lengths. Here the unit of length is explicit, ``size``, and the origin of the
object's frame is its centre:

    E = sum_n ||R_n - R_gt,n||^2 + ||c_n - c_gt,n||^2 / size^2          (Frobenius norm)

With ``size`` the root mean square distance of the object's points from its centre, over the root of 3, E size^2 is the
mean square distance by which the points of a ball of that extent are off. With an infinite size rotations alone count,
and the optimum is known in closed form. As ``||R - R'||^2 = 8 (1 - (q . q')^2)`` for unit quaternions, the nearest pose
is the first eigenvector of ``sum_n q_n q_n^T`` (Markley et al., "Averaging quaternions", 2007). Rotations about an axis
are a great circle of quaternions: the nearest one is the plane of the first two eigenvectors.

How an object moves in the hand over one grasp, as a few numbers: what a hinge explains, and what it does not.

The best hinge is that of the full poses (``approximation.pose_hinge``). What is left of each frame's pose, its
residual, is given in the hinge's own axes: along the axis, from the axis to the object's centre, and square to both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from threadpoolctl import ThreadpoolController

from getagrip.geometry import se3

HINGE_TOLERANCE = 1e-10
"""Relative change of E, and of the hinge, at which the search for the best hinge ends."""
HINGE_TRIAL_STEPS, MAX_HINGE_STEPS = 20, 200
"""Steps from each initial guess, and then from the best of them."""


@dataclass(frozen=True)
class AxisRotation:
    """A rotation of the object about one line of the hand frame.

    At the angle w it has ``R(w) = exp(w direction) R`` and ``c(w) = point + exp(w direction) arm``.

    Attributes:
        R: (3, 3) rotation of the object at angle 0.
        direction: (3,) unit vector along the axis.
        point: (3,) a point of the axis [m].
        arm: (3,) from there to the object's centre at angle 0 [m].
        size: unit of length of E [m]; infinite where rotations alone count.
    """

    R: Float[ndarray, "3 3"]
    direction: Float[ndarray, "3"]
    point: Float[ndarray, "3"]
    arm: Float[ndarray, "3"]
    size: float

    def angles(self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> Float[ndarray, "N"]:
        """Return the angle [rad] nearest to each of some poses: E is a sine wave of it."""
        d = self.direction
        M = self.R @ np.swapaxes(R, -1, -2)
        perpendicular = self.arm - d * (d @ self.arm)
        away = (c - self.point) / self.size**2
        cosine = np.trace(M, axis1=1, axis2=2) - (M @ d) @ d + away @ perpendicular
        sine = np.einsum("ij,nji->n", se3.hat(d), M) + away @ np.cross(d, perpendicular)
        return np.arctan2(sine, cosine)

    def at(self, angle: Float[ndarray, "N"]) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"]]:
        """Return the rotations, and positions of the centre [m], at some angles."""
        rotation = se3.exp_so3(angle[:, None] * self.direction)
        return rotation @ self.R, self.point + rotation @ self.arm

    def energy(self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> float:
        """Return E of the nearest poses."""
        R_found, c_found = self.nearest(R, c)
        return float(np.sum((R_found - R) ** 2) + np.sum((c_found - c) ** 2) / self.size**2)

    def nearest(
        self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]
    ) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"]]:
        """Return the hinge's own poses that are nearest to some others."""
        return self.at(self.angles(R, c))


def mean_rotation(R: Float[ndarray, "N 3 3"]) -> Float[ndarray, "3 3"]:
    """Return the rotation of least ``sum_n ||R - R_n||^2``."""
    return se3.nearest_rotation(R.sum(axis=0))


def rotation_hinge(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> AxisRotation:
    """Fit the hinge whose rotations are nearest to R, then its line to the centres."""
    return next(_initial_hinges(R, c, np.inf, None))


def pose_hinge(
    R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float, through: Float[ndarray, "3"] | None = None
) -> AxisRotation:
    """Fit the hinge of least E, anywhere or through a point of the hand frame [m].

    E is minimised over the hinge, the angles always the best ones, by Levenberg-Marquardt from four initial guesses:
    the two best axes that the eigenvectors of the quaternions span with the mean rotation, each with the best angles
    of its rotations, and with all angles zero. The latter begin at the E of the best single pose, and E only falls.
    """
    with _threadpool_controller().limit(
        limits=1, user_api="blas"
    ):  # several threads on such small matrices wait for each other
        guesses = list(_initial_hinges(R, c, size, through))[:2]
        guesses += [_static_hinge(guess, R, c, through) for guess in guesses]
        tried = [_minimise_hinge(guess, R, c, through, HINGE_TRIAL_STEPS) for guess in guesses]
        best = min(tried, key=lambda hinge: hinge.energy(R, c))
        return _minimise_hinge(best, R, c, through, MAX_HINGE_STEPS)


def nearby_hinge(start: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> AxisRotation:
    """Refine a good guess of the hinge by a few steps; several times as quick as ``pose_hinge``."""
    with _threadpool_controller().limit(limits=1, user_api="blas"):
        return _minimise_hinge(start, R, c, None, HINGE_TRIAL_STEPS)


@cache  # to look for them takes longer than a few steps
def _threadpool_controller() -> ThreadpoolController:
    """Return a controller of the libraries that use several threads."""
    import scipy.optimize  # noqa: F401  (first: it brings a BLAS of its own)

    return ThreadpoolController()


def _initial_hinges(
    R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float, through: Float[ndarray, "3"] | None
) -> Iterator[AxisRotation]:
    """Hinges through the mean rotation, the nearest to the rotations first."""
    q = se3.quaternion(R)
    _, vectors = np.linalg.eigh(q.T @ q)
    mean = vectors[:, 3]
    R_mean = se3.from_quaternion(mean)
    for other in (vectors[:, 2], vectors[:, 1], vectors[:, 0]):
        w, v = mean[0], mean[1:]
        direction = w * other[1:] - other[0] * v - np.cross(other[1:], v)  # other times mean's conjugate
        direction /= np.linalg.norm(direction)
        angle = AxisRotation(R_mean, direction, np.zeros(3), np.zeros(3), np.inf).angles(R, c)
        point, arm = _fit_axis_line(direction, angle, c, through)
        yield AxisRotation(R_mean, direction, point, arm, size)


def _fit_axis_line(
    direction: Float[ndarray, "3"],
    angle: Float[ndarray, "N"],
    c: Float[ndarray, "N 3"],
    through: Float[ndarray, "3"] | None,
) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]]:
    """Point and arm for which the centre, rotated by the angles, is nearest to c: linear least squares."""
    rotation = se3.exp_so3(angle[:, None] * direction)
    if through is not None:
        arm = (np.swapaxes(rotation, -1, -2) @ (c - through)[..., None])[..., 0].mean(axis=0)
        return through, arm
    rows = np.concatenate([np.broadcast_to(np.eye(3), rotation.shape), rotation], axis=-1).reshape(-1, 6)
    solution = np.linalg.lstsq(rows, c.ravel(), rcond=1e-9)[0]
    return solution[:3], solution[3:]


def _static_hinge(
    hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], through: Float[ndarray, "3"] | None
) -> AxisRotation:
    """Return the hinge of the same direction through the mean centre (or the given point), the mean pose at angle 0."""
    point = c.mean(axis=0) if through is None else through
    return replace(hinge, R=mean_rotation(R), point=point, arm=c.mean(axis=0) - point)


def _minimise_hinge(
    start: AxisRotation,
    R: Float[ndarray, "N 3 3"],
    c: Float[ndarray, "N 3"],
    through: Float[ndarray, "3"] | None,
    steps: int,
) -> AxisRotation:
    """Refine a hinge by at most ``steps`` steps; E never rises."""
    from scipy.optimize import least_squares

    moves = _HingeTangents.of(start, free=through is None)

    def residuals(x: Float[ndarray, "k"]) -> Float[ndarray, "m"]:
        R_found, c_found = moves.hinge(x).nearest(R, c)
        return np.concatenate([(R_found - R).reshape(-1, 9), (c_found - c) / start.size], axis=1).ravel()

    def jacobian(x: Float[ndarray, "k"]) -> Float[ndarray, "m k"]:
        return moves.jacobian(x, moves.hinge(x).angles(R, c))

    x = np.zeros(11 if through is None else 8)
    solution = least_squares(
        residuals, x, jacobian, xtol=HINGE_TOLERANCE, ftol=HINGE_TOLERANCE, gtol=1e-14, max_nfev=steps
    )
    return moves.hinge(solution.x)


@dataclass(frozen=True)
class _HingeTangents:
    """Hinges around one: rotation of R (3), tilt of the axis (2), step of the arm (3) and of the point (3 if free).

    Some of these move nothing (a rotation of R and arm about the axis, a step of the point along it): the solver takes
    the shortest steps.
    """

    start: AxisRotation
    tilts: Float[ndarray, "2 3"]
    free: bool

    @classmethod
    def of(cls, start: AxisRotation, free: bool) -> _HingeTangents:
        return cls(start, np.linalg.svd(start.direction[None])[2][1:], free)

    def hinge(self, x: Float[ndarray, "k"]) -> AxisRotation:
        start = self.start
        direction = start.direction + x[3:5] @ self.tilts
        return replace(
            start,
            R=se3.exp_so3(x[:3]) @ start.R,
            direction=direction / np.linalg.norm(direction),
            arm=start.arm + start.size * x[5:8],
            point=start.point + start.size * x[8:11] if self.free else start.point,
        )

    def jacobian(self, x: Float[ndarray, "k"], angle: Float[ndarray, "N"]) -> Float[ndarray, "m k"]:
        """Compute derivatives of the poses' 9 + 3 numbers in each frame.

        What a change of the frame's angle undoes is left out: the angles are always the best ones. That they are to
        first order is enough (Kaufman, "A variable projection method for solving separable nonlinear least squares
        problems", 1975): the gradient of E is exact.
        """
        hinge, size = self.hinge(x), self.start.size
        d = hinge.direction
        rotation = se3.exp_so3(angle[:, None] * d)
        away = rotation @ hinge.arm
        stretched = self.start.direction + x[3:5] @ self.tilts
        tilt = (self.tilts - np.outer(self.tilts @ d, d)).T / np.linalg.norm(stretched)
        turn, step = np.zeros((2, len(angle), 3, len(x) + 1))  # in the hand frame, by x and, last, the angle
        turn[..., :3] = rotation @ se3.left_jacobian(x[:3])
        sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        turn[..., 3:5] = sine * tilt + (1.0 - cosine) * (se3.hat(d) @ tilt)
        turn[..., -1] = d
        step[..., 3:] = -se3.hat(away) @ turn[..., 3:]
        step[..., 5:8] = size * rotation
        if self.free:
            step[..., 8:11] = size * np.eye(3)
        columns = np.swapaxes(rotation @ hinge.R, -1, -2)  # each moves by turn x column
        spun = -np.swapaxes(se3.hat(columns), 1, 2).reshape(-1, 9, 3) @ turn
        J = np.concatenate([spun, step / size], axis=1)
        J, along = J[..., :-1], J[..., -1:]
        J = J - along * (np.swapaxes(along, 1, 2) @ J) / np.sum(along**2, axis=1, keepdims=True)
        return np.asarray(J.reshape(-1, len(x)))


MIN_DRIFT_TURN_RAD = np.radians(5.0)
"""Each half of a grasp turns at least so far where the drift of the axis is measured."""
N_SPECTRUM_MODES = 12
"""Number of cosines over the grasp's time in a spectrum, the constant left out; the last has all that is faster."""
SLIP_END_FRACTION = 0.2
"""Share of the frames at either end between which slip is measured."""
MOTION_PERCENTILES = (10, 25, 50, 75, 90)
"""Per cent."""
LOGNORMAL_MEASURES = ("duration", "turn", "rotation", "place", "drift", "pivot", "slip")
"""Measures of a grasp whose logarithms are taken to be jointly normal: how long it lasts, the range of the angle about
the best hinge, rotation and translation besides it (root mean square), the angle between the axes of both halves, the
axis's distance from the middle of the contact, and the way of the contact points in the hand, first to last fifth."""


@dataclass(frozen=True)
class HingeResidual:
    """A motion beside its best hinge.

    Attributes:
        hinge: the best hinge.
        angle: (N,) angle about it [rad].
        rotation: (N, 3) rotation vector of the residual in the hinge's axes [rad].
        place: (N, 3) displacement of the object's centre in the hinge's axes [m].
    """

    hinge: AxisRotation
    angle: Float[ndarray, "N"]
    rotation: Float[ndarray, "N 3"]
    place: Float[ndarray, "N 3"]

    @staticmethod
    def of(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float) -> HingeResidual:
        """Compute the residual from rotations and centres [m] of an object of some size [m]."""
        return HingeResidual.beside(pose_hinge(R, c, size), R, c)

    @staticmethod
    def beside(hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> HingeResidual:
        """Compute the residual beside a hinge that is known."""
        angle = np.unwrap(hinge.angles(R, c))
        R_hinge, c_hinge = hinge.at(angle)
        axes = hinge_axes(hinge.direction, se3.exp_so3(np.median(angle) * hinge.direction) @ hinge.arm)
        rotation = se3.log_so3(R @ np.swapaxes(R_hinge, -1, -2))
        return HingeResidual(hinge, angle, rotation @ axes, (c - c_hinge) @ axes)

    @property
    def sizes(self) -> Float[ndarray, "3"]:
        """Range of the angle [rad], root mean square rotation [rad] and translation [m] of the residual."""
        spreads = [np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in (self.rotation, self.place)]
        return np.array([np.ptp(self.angle), *spreads])


def hinge_axes(direction: Float[ndarray, "3"], arm: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Return unit vectors, as columns.

    They point along an axis, along the arm as far as it is square to the axis, and square to both.
    """
    across = arm - direction * (direction @ arm)
    if np.linalg.norm(across) < 1e-9:
        across = np.linalg.svd(direction[None])[2][1]
    across = across / np.linalg.norm(across)
    return np.stack([direction, across, np.cross(direction, across)], axis=1)


def measure_motion(
    T_hand_obj: Float[ndarray, "N 4 4"],
    centre: Float[ndarray, "3"],
    size: float,
    touched: Float[ndarray, "P 3"],
    fps: float,
) -> tuple[dict[str, float], HingeResidual]:
    """Measure ``LOGNORMAL_MEASURES`` of one grasp in SI units, NaN where one has no value; also return the residual of the hinge.

    Args:
        T_hand_obj: poses of the object, of unit scale.
        centre: its centre, in its own frame [m].
        size: its size [m], as for ``pose_hinge``.
        touched: points of it that are in contact, in its own frame [m]; may be none.
        fps: frames per second.
    """
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    residual = HingeResidual.of(R, c, size)
    turn, rotation, place = map(float, residual.sizes)
    values = {
        "duration": len(R) / fps,
        "turn": turn,
        "rotation": rotation,
        "place": place,
        "drift": axis_drift(R, c),
        "pivot": np.nan,
        "slip": np.nan,
    }
    if len(touched):
        way = se3.transform(T_hand_obj, touched)
        direction = residual.hinge.direction
        off = way.mean(axis=(0, 1)) - residual.hinge.point
        end = max(1, round(SLIP_END_FRACTION * len(R)))
        values["pivot"] = float(np.linalg.norm(off - direction * (direction @ off)))
        moved = way[-end:].mean(axis=0) - way[:end].mean(axis=0)
        values["slip"] = float(np.linalg.norm(moved, axis=-1).mean())
    return values, residual


def axis_drift(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> float:
    """Measure the angle between the best axes of the rotations of both halves [rad]; NaN where one hardly turns."""
    half = len(R) // 2
    hinges = [rotation_hinge(R[part], c[part]) for part in (slice(half), slice(half, None))]
    for hinge, part in zip(hinges, (slice(half), slice(half, None)), strict=True):
        if np.ptp(np.unwrap(hinge.angles(R[part], c[part]))) < MIN_DRIFT_TURN_RAD:
            return float("nan")
    return float(np.arccos(min(1.0, abs(float(hinges[0].direction @ hinges[1].direction)))))


def parabola_share(residual: HingeResidual) -> float:
    """Measure the share of the residual's rotation square to the axis that a parabola of the angle explains."""
    x = residual.rotation[:, 1:]
    powers = np.vander(residual.angle - residual.angle.mean(), 3)
    unexplained = x - powers @ np.linalg.lstsq(powers, x, rcond=None)[0]
    whole = np.sum(x**2)
    return float(1.0 - np.sum(unexplained**2) / whole) if whole > 0.0 else float("nan")


def spectrum(x: Float[ndarray, "N k"]) -> Float[ndarray, "M"]:
    """Measure the share of a curve's energy in each of ``N_SPECTRUM_MODES`` cosines cos(pi m t), without the constant."""
    from scipy.fft import dct

    energy = np.sum(dct(x, axis=0, norm="ortho")[1:] ** 2, axis=1)
    shares = np.zeros(N_SPECTRUM_MODES)
    shares[: min(N_SPECTRUM_MODES, len(energy))] = energy[:N_SPECTRUM_MODES]
    shares[-1] += energy[N_SPECTRUM_MODES:].sum()
    return shares / shares.sum()


@dataclass(frozen=True)
class MotionStatistics:
    """Statistics over all grasps; nothing of a single one.

    Attributes:
        grasps: number of grasps.
        quantiles: of each measure, in SI units, at ``MOTION_PERCENTILES``; of the grasps that have a value.
        log_mean: (J,) mean of the logarithms of ``LOGNORMAL_MEASURES``, in SI units, of the grasps that have a value.
        log_covariance: (J, J) their covariance, of each two in the grasps that have both.
        angle: (M,) ``spectrum`` of the angle about the hinge, mean over grasps.
        rotation: (M,) spectrum of the residual's rotation.
        place: (M,) spectrum of its translation.
        rotation_shares: (3,) share of the rotation's energy about each of the hinge's axes.
        place_shares: (3,) share of the translation's energy along each.
    """

    grasps: int
    quantiles: dict[str, Sequence[float]]
    log_mean: Sequence[float]
    log_covariance: Sequence[Sequence[float]]
    angle: Sequence[float]
    rotation: Sequence[float]
    place: Sequence[float]
    rotation_shares: Sequence[float]
    place_shares: Sequence[float]
