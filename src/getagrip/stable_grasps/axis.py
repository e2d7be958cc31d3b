"""The best hinge of an object's motion in the hand (paper, Eq. 3 and 4), and measures of the motion besides it.

Poses are rotations R_n (object to hand) and positions c_n of the object's centre in the hand frame. The paper's
``||T_n - T_gt,n||^2`` adds rotations to lengths. Here the unit of length is explicit, ``size``, and the origin of the
object's frame is its centre:

    E = sum_n ||R_n - R_gt,n||^2 + ||c_n - c_gt,n||^2 / size^2          (Frobenius norm)

If ``size`` is the root mean square distance of the object's points from its centre, over the root of 3, E size^2 is the
mean squared distance between corresponding points of a ball of that extent. With an infinite size only rotations count,
and the optimum has a closed form. As ``||R - R'||^2 = 8 (1 - (q . q')^2)`` for unit quaternions, the nearest pose is
the first eigenvector of ``sum_n q_n q_n^T`` (Markley et al., "Averaging quaternions", 2007). Rotations about an axis
are a great circle of quaternions: the nearest circle is the plane of the first two eigenvectors.

A residual is a frame's deviation from the best hinge of the full poses (``pose_hinge``), in the hinge's own axes: along
the axis, from the axis to the object's centre, and perpendicular to both.
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
"""Relative change of E, and of the hinge, at which the minimisation ends."""
HINGE_TRIAL_STEPS, MAX_HINGE_STEPS = 20, 200
"""Maximum number of steps from each initial guess, and from the best result of these."""
MIN_DRIFT_TURN_RAD = np.radians(5.0)
"""Minimum rotation in each half of a grasp for the drift of the axis to be measured [rad]."""
N_SPECTRUM_MODES = 12
"""Number of cosines of a spectrum, without the constant; the last one includes all faster ones."""
SLIP_END_FRACTION = 0.2
"""Fraction of the frames at either end; slip is measured between the means of both ends."""
MOTION_PERCENTILES = (10, 25, 50, 75, 90)
"""Percentiles of each measure that ``MotionStatistics`` holds."""
LOGNORMAL_MEASURES = ("duration", "turn", "rotation", "place", "drift", "pivot", "slip")
"""Measures of a grasp whose logarithms are assumed to be jointly normal: its duration, the range of the angle about the
best hinge, rotation and translation of the residual (root mean square), the angle between the axes of both halves, the
axis's distance from the centre of contact, and the displacement of contact points in the hand, first to last fifth."""


@dataclass(frozen=True)
class AxisRotation:
    """A hinge: rotations of the object about one line in the hand frame.

    At the angle w, ``R(w) = exp(w direction) R`` and ``c(w) = point + exp(w direction) arm``.

    Attributes:
        R: (3, 3) rotation of the object at angle 0.
        direction: (3,) unit vector along the axis.
        point: (3,) a point on the axis [m].
        arm: (3,) vector from this point to the object's centre at angle 0 [m].
        size: unit of length of E [m]; infinite where only rotations count.
    """

    R: Float[ndarray, "3 3"]
    direction: Float[ndarray, "3"]
    point: Float[ndarray, "3"]
    arm: Float[ndarray, "3"]
    size: float

    def angles(self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> Float[ndarray, "N"]:
        """Compute the hinge's angle nearest to each pose [rad]: E is a sine wave of the angle."""
        d = self.direction
        M = self.R @ np.swapaxes(R, -1, -2)
        perpendicular = self.arm - d * (d @ self.arm)
        away = (c - self.point) / self.size**2
        cosine = np.trace(M, axis1=1, axis2=2) - (M @ d) @ d + away @ perpendicular
        sine = np.einsum("ij,nji->n", se3.hat(d), M) + away @ np.cross(d, perpendicular)
        return np.arctan2(sine, cosine)

    def at(self, angle: Float[ndarray, "N"]) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"]]:
        """Return the rotations, and the positions of the centre [m], at some angles [rad]."""
        rotation = se3.exp_so3(angle[:, None] * self.direction)
        return rotation @ self.R, self.point + rotation @ self.arm

    def energy(self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> float:
        """Compute E of the hinge's nearest poses."""
        R_found, c_found = self.nearest(R, c)
        return float(np.sum((R_found - R) ** 2) + np.sum((c_found - c) ** 2) / self.size**2)

    def nearest(
        self, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]
    ) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"]]:
        """Compute the hinge's poses nearest to the given ones."""
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
    """Fit the hinge of least E, anywhere or ``through`` a point of the hand frame [m].

    Levenberg-Marquardt minimises E over the hinge, always with the best angles, from four initial guesses: the mean
    rotation with each of the two best axes (eigenvectors of the quaternions), with the best angles and with all angles
    zero. The latter start at the E of the best single pose, and E only decreases.
    """
    with _threadpool_controller().limit(limits=1, user_api="blas"):  # on small matrices threads wait for each other
        guesses = list(_initial_hinges(R, c, size, through))[:2]
        guesses += [_static_hinge(guess, R, c, through) for guess in guesses]
        tried = [_minimise_hinge(guess, R, c, through, HINGE_TRIAL_STEPS) for guess in guesses]
        best = min(tried, key=lambda hinge: hinge.energy(R, c))
        return _minimise_hinge(best, R, c, through, MAX_HINGE_STEPS)


def nearby_hinge(start: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> AxisRotation:
    """Refine a good initial guess of the hinge by a few steps; several times faster than ``pose_hinge``."""
    with _threadpool_controller().limit(limits=1, user_api="blas"):
        return _minimise_hinge(start, R, c, None, HINGE_TRIAL_STEPS)


@cache  # the look-up takes longer than a few steps of a fit
def _threadpool_controller() -> ThreadpoolController:
    import scipy.optimize  # noqa: F401  (first: it loads a BLAS of its own)

    return ThreadpoolController()


def _initial_hinges(
    R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float, through: Float[ndarray, "3"] | None
) -> Iterator[AxisRotation]:
    """Yield the hinges through the mean rotation, those nearest to the rotations first."""
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
    """Fit point and arm to the centres by linear least squares, at known angles."""
    rotation = se3.exp_so3(angle[:, None] * direction)
    if through is not None:
        return through, (np.swapaxes(rotation, -1, -2) @ (c - through)[..., None])[..., 0].mean(axis=0)
    rows = np.concatenate([np.broadcast_to(np.eye(3), rotation.shape), rotation], axis=-1).reshape(-1, 6)
    solution = np.linalg.lstsq(rows, c.ravel(), rcond=1e-9)[0]
    return solution[:3], solution[3:]


def _static_hinge(
    hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], through: Float[ndarray, "3"] | None
) -> AxisRotation:
    """Move a hinge's axis to the mean centre (or ``through``), with the mean pose at angle 0."""
    point = c.mean(axis=0) if through is None else through
    return replace(hinge, R=mean_rotation(R), point=point, arm=c.mean(axis=0) - point)


def _minimise_hinge(
    start: AxisRotation,
    R: Float[ndarray, "N 3 3"],
    c: Float[ndarray, "N 3"],
    through: Float[ndarray, "3"] | None,
    steps: int,
) -> AxisRotation:
    """Minimise E by at most ``steps`` steps from a hinge; E never increases."""
    from scipy.optimize import least_squares

    moves = _HingeTangents.of(start, free=through is None)

    def residuals(x: Float[ndarray, "k"]) -> Float[ndarray, "m"]:
        R_found, c_found = moves.hinge(x).nearest(R, c)
        return np.concatenate([(R_found - R).reshape(-1, 9), (c_found - c) / start.size], axis=1).ravel()

    def jacobian(x: Float[ndarray, "k"]) -> Float[ndarray, "m k"]:
        return moves.jacobian(x, moves.hinge(x).angles(R, c))

    x = np.zeros(11 if through is None else 8)
    tolerances = {"xtol": HINGE_TOLERANCE, "ftol": HINGE_TOLERANCE, "gtol": 1e-14}
    solution = least_squares(residuals, x, jacobian, max_nfev=steps, **tolerances)
    return moves.hinge(solution.x)


@dataclass(frozen=True)
class _HingeTangents:
    """Parameters of hinges near one: rotation of R (3), tilt of the axis (2), step of arm (3) and point (3 if free).

    Some combinations have no effect (rotating R and arm about the axis, moving the point along it): the solver takes
    the shortest step.
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

        The component along the derivative by the frame's angle is projected out, since angles are always optimal. First
        order suffices (Kaufman, "A variable projection method for solving separable nonlinear least squares problems",
        1975): the gradient of E is exact.
        """
        hinge, size = self.hinge(x), self.start.size
        d = hinge.direction
        rotation = se3.exp_so3(angle[:, None] * d)
        away = rotation @ hinge.arm
        stretched = self.start.direction + x[3:5] @ self.tilts
        tilt = (self.tilts - np.outer(self.tilts @ d, d)).T / np.linalg.norm(stretched)
        turn, step = np.zeros((2, len(angle), 3, len(x) + 1))  # in the hand frame, by x and, last, by the angle
        turn[..., :3] = rotation @ se3.left_jacobian(x[:3])
        sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        turn[..., 3:5] = sine * tilt + (1.0 - cosine) * (se3.hat(d) @ tilt)
        turn[..., -1] = d
        step[..., 3:] = -se3.hat(away) @ turn[..., 3:]
        step[..., 5:8] = size * rotation
        if self.free:
            step[..., 8:11] = size * np.eye(3)
        columns = np.swapaxes(rotation @ hinge.R, -1, -2)  # each has the derivative turn x column
        spun = -np.swapaxes(se3.hat(columns), 1, 2).reshape(-1, 9, 3) @ turn
        J = np.concatenate([spun, step / size], axis=1)
        J, along = J[..., :-1], J[..., -1:]
        J = J - along * (np.swapaxes(along, 1, 2) @ J) / np.sum(along**2, axis=1, keepdims=True)
        return np.asarray(J.reshape(-1, len(x)))


@dataclass(frozen=True)
class HingeResidual:
    """A motion relative to its best hinge.

    Attributes:
        hinge: the best hinge.
        angle: (N,) angle about it [rad].
        rotation: (N, 3) rotation vector of the residual, in the hinge's axes [rad].
        place: (N, 3) displacement of the object's centre, in the hinge's axes [m].
    """

    hinge: AxisRotation
    angle: Float[ndarray, "N"]
    rotation: Float[ndarray, "N 3"]
    place: Float[ndarray, "N 3"]

    @staticmethod
    def of(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float) -> HingeResidual:
        """Compute the residual of rotations and centres [m] from their best hinge, found with ``size`` [m]."""
        return HingeResidual.beside(pose_hinge(R, c, size), R, c)

    @staticmethod
    def beside(hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> HingeResidual:
        """Compute the residual of rotations and centres [m] from a known hinge."""
        angle = np.unwrap(hinge.angles(R, c))
        R_hinge, c_hinge = hinge.at(angle)
        axes = hinge_axes(hinge.direction, se3.exp_so3(np.median(angle) * hinge.direction) @ hinge.arm)
        rotation = se3.log_so3(R @ np.swapaxes(R_hinge, -1, -2))
        return HingeResidual(hinge, angle, rotation @ axes, (c - c_hinge) @ axes)

    @property
    def sizes(self) -> Float[ndarray, "3"]:
        """Range of the angle [rad], and root mean square rotation [rad] and translation [m] of the residual."""
        spreads = [np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in (self.rotation, self.place)]
        return np.array([np.ptp(self.angle), *spreads])


def hinge_axes(direction: Float[ndarray, "3"], arm: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Return three unit vectors, as columns.

    The first is the axis, the second the arm's component perpendicular to it, the third is perpendicular to both.
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
    """Compute ``LOGNORMAL_MEASURES`` of one grasp in SI units (NaN: unknown), and its residual from the best hinge.

    Args:
        T_hand_obj: poses of the object, at scale 1.
        centre: the object's centre, in its own frame [m].
        size: the object's size [m], as in ``pose_hinge``.
        touched: the object's points in contact, in its own frame [m]; may be empty.
        fps: frames per second.
    """
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    residual = HingeResidual.of(R, c, size)
    turn, rotation, place = map(float, residual.sizes)
    values = {"duration": len(R) / fps, "turn": turn, "rotation": rotation, "place": place}
    values |= {"drift": axis_drift(R, c), "pivot": np.nan, "slip": np.nan}
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
    """Compute the angle between the best axes of both halves [rad]; NaN where one half hardly turns."""
    half = len(R) // 2
    halves = slice(half), slice(half, None)
    hinges = [rotation_hinge(R[part], c[part]) for part in halves]
    for hinge, part in zip(hinges, halves, strict=True):
        if np.ptp(np.unwrap(hinge.angles(R[part], c[part]))) < MIN_DRIFT_TURN_RAD:
            return float("nan")
    return float(np.arccos(min(1.0, abs(float(hinges[0].direction @ hinges[1].direction)))))


def parabola_share(residual: HingeResidual) -> float:
    """Compute the fraction of the residual's rotation square to the axis that a parabola of the angle explains."""
    x = residual.rotation[:, 1:]
    powers = np.vander(residual.angle - residual.angle.mean(), 3)
    unexplained = x - powers @ np.linalg.lstsq(powers, x, rcond=None)[0]
    whole = np.sum(x**2)
    return float(1.0 - np.sum(unexplained**2) / whole) if whole > 0.0 else float("nan")


def spectrum(x: Float[ndarray, "N k"]) -> Float[ndarray, "M"]:
    """Compute the fraction of a curve's energy in each of the cosines cos(pi m t), m = 1 to ``N_SPECTRUM_MODES``."""
    from scipy.fft import dct

    energy = np.sum(dct(x, axis=0, norm="ortho")[1:] ** 2, axis=1)
    shares = np.zeros(N_SPECTRUM_MODES)
    shares[: min(N_SPECTRUM_MODES, len(energy))] = energy[:N_SPECTRUM_MODES]
    shares[-1] += energy[N_SPECTRUM_MODES:].sum()
    return shares / shares.sum()


@dataclass(frozen=True)
class MotionStatistics:
    """Statistics over many grasps.

    Attributes:
        grasps: number of grasps.
        quantiles: each measure's ``MOTION_PERCENTILES``, in SI units, over the grasps with a value.
        log_mean: (J,) mean of the logarithms of ``LOGNORMAL_MEASURES``, in SI units, over the grasps with a value.
        log_covariance: (J, J) covariances of these logarithms, each over the grasps with both values.
        angle: (M,) ``spectrum`` of the angle about the hinge, mean over grasps.
        rotation: (M,) spectrum of the residual's rotation.
        place: (M,) spectrum of the residual's translation.
        rotation_shares: (3,) fraction of the rotation's energy about each of the hinge's axes.
        place_shares: (3,) fraction of the translation's energy along each of these axes.
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
