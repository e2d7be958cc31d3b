"""How an object moves in the hand over one grasp, as a few numbers: what a hinge explains, and what it does not.

The best hinge is that of the full poses (``approximation.pose_hinge``). What is left of each frame's pose, its
residual, is given in the hinge's own axes: along the axis, from the axis to the object's centre, and square to both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.grasps.approximation import AxisRotation, pose_hinge, rotation_hinge

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
