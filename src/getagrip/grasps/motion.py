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
from getagrip.grasps.approximation import AxisRotation, mean_rotation, pose_hinge, rotation_hinge
from getagrip.grasps.study import Measure

LEAST_TURN = np.radians(5.0)
"""Each half of a grasp turns at least so far where the drift of the axis is measured."""
MODES = 12
"""Number of cosines over the grasp's time in a spectrum, the constant left out; the last has all that is faster."""
ENDS = 0.2
"""Share of the frames at either end between which slip is measured."""

MOTION_MEASURES = {
    "duration": Measure("duration", "s", 1.0),
    "turn": Measure("range of the angle about the best hinge", "deg", float(np.degrees(1.0))),
    "static": Measure("rotation error of one pose, mean", "deg", float(np.degrees(1.0))),
    "rotation": Measure("rotation besides the best hinge, rms", "deg", float(np.degrees(1.0))),
    "place": Measure("translation of the centre besides the best hinge, rms", "mm", 1e3),
    "drift": Measure("angle between the axes of the first and the second half", "deg", float(np.degrees(1.0))),
    "bend": Measure("share of the rotation square to the axis that goes with the angle's square", "", 1.0),
    "rotation_memory": Measure("correlation time of that rotation", "s", 1.0),
    "place_memory": Measure("correlation time of that translation", "s", 1.0),
    "pivot": Measure("distance of the axis from the middle of the contact", "mm", 1e3),
    "slip": Measure("way of the contact points in the hand frame, first to last fifth", "mm", 1e3),
}
"""By name; shown in these units, stored in SI units."""


@dataclass(frozen=True)
class Residual:
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
    def of(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"], size: float) -> Residual:
        """Compute the residual from rotations and centres [m] of an object of some size [m]."""
        return Residual.beside(pose_hinge(R, c, size), R, c)

    @staticmethod
    def beside(hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> Residual:
        """Compute the residual beside a hinge that is known."""
        angle = np.unwrap(hinge.angles(R, c))
        R_hinge, c_hinge = hinge.at(angle)
        axes = hinge_axes(hinge.direction, se3.exp_so3(np.median(angle) * hinge.direction) @ hinge.arm)
        rotation = se3.log_so3(R @ np.swapaxes(R_hinge, -1, -2))
        return Residual(hinge, angle, rotation @ axes, (c - c_hinge) @ axes)

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


def measure(
    T_hand_obj: Float[ndarray, "N 4 4"],
    centre: Float[ndarray, "3"],
    size: float,
    touched: Float[ndarray, "P 3"],
    fps: float,
) -> tuple[dict[str, float], Residual]:
    """Measure ``MOTION_MEASURES`` of one grasp, NaN where one has no value; also return the residual of the hinge.

    Args:
        T_hand_obj: poses of the object, of unit scale.
        centre: its centre, in its own frame [m].
        size: its size [m], as for ``pose_hinge``.
        touched: points of it that are in contact, in its own frame [m]; may be none.
        fps: frames per second.
    """
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    residual = Residual.of(R, c, size)
    turn, rotation, place = map(float, residual.sizes)
    values = {
        "duration": len(R) / fps,
        "turn": turn,
        "static": float(se3.angle_between(mean_rotation(R), R).mean()),
        "rotation": rotation,
        "place": place,
        "drift": axis_drift(R, c),
        "bend": bend(residual),
        "rotation_memory": correlation_time(residual.rotation, fps),
        "place_memory": correlation_time(residual.place, fps),
        "pivot": np.nan,
        "slip": np.nan,
    }
    if len(touched):
        way = se3.transform(T_hand_obj, touched)
        direction = residual.hinge.direction
        off = way.mean(axis=(0, 1)) - residual.hinge.point
        end = max(1, round(ENDS * len(R)))
        values["pivot"] = float(np.linalg.norm(off - direction * (direction @ off)))
        moved = way[-end:].mean(axis=0) - way[:end].mean(axis=0)
        values["slip"] = float(np.linalg.norm(moved, axis=-1).mean())
    return values, residual


def axis_drift(R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]) -> float:
    """Measure the angle between the best axes of the rotations of both halves [rad]; NaN where one hardly turns."""
    half = len(R) // 2
    hinges = [rotation_hinge(R[part], c[part]) for part in (slice(half), slice(half, None))]
    for hinge, part in zip(hinges, (slice(half), slice(half, None)), strict=True):
        if np.ptp(np.unwrap(hinge.angles(R[part], c[part]))) < LEAST_TURN:
            return float("nan")
    return float(np.arccos(min(1.0, abs(float(hinges[0].direction @ hinges[1].direction)))))


def bend(residual: Residual) -> float:
    """Measure the share of the residual's rotation square to the axis that a parabola of the angle explains."""
    x = residual.rotation[:, 1:]
    powers = np.vander(residual.angle - residual.angle.mean(), 3)
    unexplained = x - powers @ np.linalg.lstsq(powers, x, rcond=None)[0]
    whole = np.sum(x**2)
    return float(1.0 - np.sum(unexplained**2) / whole) if whole > 0.0 else float("nan")


def correlation_time(x: Float[ndarray, "N 3"], fps: float) -> float:
    """Measure the lag at which a curve's autocorrelation first falls to 1/e [s], linear between frames.

    At most half of it.
    """
    x = x - x.mean(axis=0)
    lags = np.arange(len(x) // 2)
    product = np.array([np.mean(np.sum(x[: len(x) - lag] * x[lag:], axis=1)) for lag in lags])
    if product[0] <= 0.0:
        return float("nan")
    correlation = product / product[0]
    below = np.flatnonzero(correlation < np.exp(-1.0))
    if not below.size:
        return float(lags[-1] / fps)
    k = int(below[0])
    part = (correlation[k - 1] - np.exp(-1.0)) / (correlation[k - 1] - correlation[k])
    return float((k - 1 + part) / fps)


def spectrum(x: Float[ndarray, "N k"]) -> Float[ndarray, "M"]:
    """Measure the share of a curve's energy in each of ``MODES`` cosines cos(pi m t), without the constant."""
    from scipy.fft import dct

    energy = np.sum(dct(x, axis=0, norm="ortho")[1:] ** 2, axis=1)
    shares = np.zeros(MODES)
    shares[: min(MODES, len(energy))] = energy[:MODES]
    shares[-1] += energy[MODES:].sum()
    return shares / shares.sum()


QUANTILES = (10, 25, 50, 75, 90)
"""Per cent."""
JOINT = ("duration", "turn", "rotation", "place", "drift", "pivot", "slip")
"""Measures whose logarithms are taken to be jointly normal."""


@dataclass(frozen=True)
class MotionStatistics:
    """Statistics over all grasps; nothing of a single one.

    Attributes:
        grasps: number of grasps.
        quantiles: of each measure, in SI units, at ``QUANTILES``; of the grasps that have a value.
        log_mean: (J,) mean of the logarithms of ``JOINT``, in SI units, of the grasps that have a value.
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

    @staticmethod
    def of(measured: Sequence[tuple[dict[str, float], Residual]]) -> MotionStatistics:
        """Compute the statistics of several grasps, as ``measure`` gives them."""
        values = {name: np.array([one[name] for one, _ in measured]) for name in MOTION_MEASURES}
        logs = np.log([values[name] for name in JOINT])
        known, mean = np.isfinite(logs), np.nanmean(logs, axis=1)
        off = np.where(known, logs - mean[:, None], 0.0)
        pairs = known.astype(float) @ known.T
        residuals = [residual for _, residual in measured]
        return MotionStatistics(
            grasps=len(measured),
            quantiles={name: _rounded(np.percentile(x[np.isfinite(x)], QUANTILES)) for name, x in values.items()},
            log_mean=_rounded(mean),
            log_covariance=tuple(_rounded(row) for row in off @ off.T / (pairs - 1.0)),
            angle=_rounded(np.mean([spectrum(r.angle[:, None]) for r in residuals], axis=0)),
            rotation=_rounded(np.mean([spectrum(r.rotation) for r in residuals], axis=0)),
            place=_rounded(np.mean([spectrum(r.place) for r in residuals], axis=0)),
            rotation_shares=_shares([r.rotation for r in residuals]),
            place_shares=_shares([r.place for r in residuals]),
        )


def _shares(curves: Sequence[Float[ndarray, "_ 3"]]) -> tuple[float, ...]:
    """Share of the energy in each of three components, mean over curves."""
    energy = np.array([np.mean(x**2, axis=0) for x in curves])
    return _rounded((energy / energy.sum(axis=1, keepdims=True)).mean(axis=0))


def _rounded(values: Float[ndarray, "n"]) -> tuple[float, ...]:
    """Four digits, more than these numbers are known to."""
    return tuple(float(f"{x:.4g}") for x in values)
