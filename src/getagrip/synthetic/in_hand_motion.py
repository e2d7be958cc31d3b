"""Motions of a synthetic scene: the object in the hand, the fingers, the hand, the camera and the other hand.

``draw_hinge_motion``: about one axis near the contacts (Eq. 3 of the paper), with a small smooth residual: nearly the
fitted motion model.

``draw_measured_motion``: as measured in real grasps (``MOTION_STATISTICS``). Drawn are the range of the angle, the size
of the residual, the duration, the drift of the axis, its distance from the contacts and their slip; so are the
fractions of slow and fast motion. Many random motions are scaled to the drawn sizes, and the one is taken whose
measures (``stable_grasps.axis``) are nearest to the drawn ones.

The camera is worn on the head and follows the hand, which lifts, carries and tilts the object.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands.model import PosedHand, mirrored
from getagrip.result import Axis
from getagrip.stable_grasps.axis import (
    LOGNORMAL_MEASURES,
    MOTION_PERCENTILES,
    AxisRotation,
    HingeResidual,
    MotionStatistics,
    hinge_axes,
    measure_motion,
    nearby_hinge,
    parabola_share,
    spectrum,
)
from getagrip.synthetic.grasp import MAX_HOLD_GAP_M, Grasper, MinSignedDistance
from getagrip.synthetic.scene_options import SceneOptions

MEASURED_MOTION_FILE = Path(__file__).with_name("measured_motion.json")
"""Statistics of real grasps, by ``benchmarks/motion.py``, last in commit ea913fa."""
_STORED = json.loads(MEASURED_MOTION_FILE.read_text(encoding="utf-8"))["statistics"]
MOTION_STATISTICS = {name: MotionStatistics(**row) for name, row in _STORED.items()}
"""Statistics of in-hand motion in stable grasps, by dataset; SI units."""
MAX_TURN_DEPTH_M = 0.0035
"""Maximum depth of a turning object in the open hand [m], for turns that are not measured."""
N_CANDIDATE_AXES = 24
"""Number of drawn axes."""
N_KEYFRAMES = 7
"""Number of frames in which fingers are closed about a measured motion; in between they are interpolated."""
MAX_ABS_Z_SCORE = 2.0
"""Maximum distance of a drawn number from the mean, in standard deviations."""
N_CORRECTION_ITERATIONS, N_SIZE_ONLY_ITERATIONS = 6, 2
"""Number of corrections of a drawn motion, and of the last ones, which correct its sizes only."""
N_TRIED_AXES = 6
"""Number of drawn axes that are tried: those of the least depth in the open hand."""
MAX_MOTION_DRAWS, LOG_MEASURE_TOLERANCE = 40, 0.1
"""Maximum number of drawn motions, and deviation of measures from the drawn numbers that ends the draw [logarithm]."""
MOTION_SIZE_MEASURES = ("turn", "rotation", "place")
"""Measures to which motions are scaled, in the order of ``HingeResidual.sizes``."""
MOTION_SELECTION_MEASURES = (*MOTION_SIZE_MEASURES, "drift", "pivot", "slip")
"""Measures by which a motion is chosen."""
MISSING_MEASURE_DEVIATION = 1.0
"""Deviation of a missing measure, which motions that hardly turn lack."""


def draw_egocentric_poses(
    T_hand_obj: Float[ndarray, "4 4"],
    middle: Float[ndarray, "3"],
    diameter: float,
    frames: int,
    rng: np.random.Generator,
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
    """Draw ``T_world_cam`` and ``T_world_hand`` of a hand that lifts, carries and tilts, before a head that follows it.

    World: x right, y ahead, z up, the middle of hand and object near the origin. The object starts upright, with the
    forearm coming from the right shoulder.
    """
    forearm = (T_hand_obj[:3, :3].T @ [1.0, 0.0, 0.0])[:2]
    yaw = np.arctan2(-0.8, 0.6) - np.arctan2(forearm[1], forearm[0]) + rng.normal(0.0, 0.25)
    upright = se3.exp_so3(np.array([0.0, 0.0, yaw])) @ T_hand_obj[:3, :3].T
    tilt = np.radians(rng.uniform(15.0, 45.0)) * draw_smooth_curves(rng, frames, 3)
    carried = np.array([0.06, 0.04, 0.05]) * draw_smooth_curves(rng, frames, 3)
    T_world_hand = rotate_about_point(np.zeros(3), tilt, carried) @ se3.rigid(upright, -upright @ middle)

    away = np.clip(0.24 + 1.05 * diameter, 0.36, 0.62)
    down = np.radians(rng.uniform(30.0, 60.0))
    eye = away * np.array([0.0, -np.cos(down), np.sin(down)]) + 0.025 * draw_smooth_curves(rng, frames, 3)
    target = 0.6 * carried + 0.02 * draw_smooth_curves(rng, frames, 3)
    z = target - eye
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) + 0.06 * draw_smooth_curves(rng, frames, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    T_world_cam = se3.rigid(np.stack([x, np.cross(z, x), z], axis=-1), eye)
    return T_world_cam, T_world_hand


def draw_other_hand(
    grasper: Grasper, T_cam_hand: Float[ndarray, "T 4 4"], middle: Float[ndarray, "3"], rng: np.random.Generator
) -> Float[ndarray, "T V 3"]:
    """Draw a relaxed left hand that drifts over part of the object, in the camera frame [m]."""
    frames = len(T_cam_hand)
    relaxed = np.radians([(0.0, 10.0, 10.0), *((25.0, 30.0, 15.0),) * 4])
    vertices = mirrored(grasper.posed(relaxed).vertices)
    vertices = vertices - vertices.mean(axis=0)
    turn = se3.exp_so3(rng.normal(0.0, 0.25, 3))
    # Seen from the head: back of the hand towards the eye, fingers up and to the right.
    facing = np.array([[-0.45, 0.0, 0.9], [-0.9, 0.0, -0.45], [0.0, -1.0, 0.0]]).T
    usual = se3.transform(T_cam_hand, middle[None])[:, 0].mean(axis=0)
    place = usual * rng.uniform(0.72, 0.82) + np.array([-0.09, 0.03, 0.0])
    turns, shifts = (size * draw_smooth_curves(rng, frames, 3) for size in (0.2, 0.03))
    moves = rotate_about_point(np.zeros(3), turns, shifts)
    return se3.transform(se3.rigid(None, place) @ moves, vertices @ (turn @ facing).T)


def draw_smooth_curves(rng: np.random.Generator, frames: int, curves: int) -> Float[ndarray, "T curves"]:
    """Draw slow random curves with values in [-1, 1]: sums of a few low frequencies over the clip."""
    t = np.linspace(0.0, 1.0, frames)[:, None, None]
    frequency = np.pi * np.array([1.0, 2.0, 3.0])[:, None]
    amplitude = rng.normal(size=(3, curves)) / np.array([1.0, 2.0, 4.0])[:, None]
    curve = np.sum(amplitude * np.sin(frequency * t + rng.uniform(0.0, 2.0 * np.pi, (3, curves))), axis=1)
    return np.asarray(curve / np.abs(amplitude).sum(axis=0))


def rotate_about_point(
    point: Float[ndarray, "3"], turn: Float[ndarray, "T 3"], shift: Float[ndarray, "T 3"]
) -> Float[ndarray, "T 4 4"]:
    """Turn by rotation vectors [rad] about a point, then shift [m]."""
    R = se3.exp_so3(turn)
    return se3.rigid(R, point + shift - R @ point)


@dataclass(frozen=True)
class InHand:
    """The motion of an object in the hand over a clip.

    Attributes:
        T_hand_obj: (T, 4, 4) poses of the object.
        axis: the axis of its rotation; for a measured motion, that of its best hinge.
        posed: the grasping hand.
        duration: duration [s]; None: that of the clip's frames.
    """

    T_hand_obj: Float[ndarray, "T 4 4"]
    axis: Axis
    posed: PosedHand
    duration: float | None


def draw_hinge_motion(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], options: SceneOptions, rng: np.random.Generator
) -> InHand:
    """Draw a motion that is nearly a rotation about one axis."""
    axis = _turning_axis(grasper, T_base, options, rng)
    line = se3.rotation_about_line(axis.point, axis.direction, axis.angle)
    turn = np.radians(options.residual_deg) * draw_smooth_curves(rng, options.frames, 3)
    shift = 1e-3 * options.residual_mm * draw_smooth_curves(rng, options.frames, 3)
    residual = rotate_about_point(axis.point, turn, shift)
    keys = np.linspace(axis.angle.min(), axis.angle.max(), 5)
    T_keys = se3.rotation_about_line(axis.point, axis.direction, keys) @ T_base
    posed = _close_at_keyframes(grasper, T_keys, keys, axis.angle)
    return InHand(residual @ line @ T_base, axis, posed, None)


def draw_measured_motion(
    grasper: Grasper,
    T_base: Float[ndarray, "4 4"],
    grasped: Mesh,
    frames: int,
    rng: np.random.Generator,
    datasets: Sequence[str] = tuple(MOTION_STATISTICS),
) -> InHand:
    """Draw a motion from the statistics of one of the ``datasets``, keys of ``MOTION_STATISTICS``."""
    statistics = MOTION_STATISTICS[datasets[int(rng.integers(len(datasets)))]]
    areas = grasped.vertex_areas / grasped.vertex_areas.sum()
    centre = areas @ grasped.vertices
    size = float(np.sqrt(areas @ np.sum((grasped.vertices - centre) ** 2, axis=1) / 3.0))
    drawn = draw_motion_measures(statistics, rng)
    around = rng.normal(size=(N_CANDIDATE_AXES, 2, 3))
    directions = around[:, 0] / np.linalg.norm(around[:, 0], axis=1, keepdims=True)
    off = np.cross(directions, around[:, 1])
    touching = _contact_vertices(grasper, T_base)
    points = touching.mean(axis=0) + drawn["pivot"] * off / np.linalg.norm(off, axis=1, keepdims=True)
    shallow = np.argsort(_turning_depth(grasper, T_base, points, directions, drawn["turn"]))[:N_TRIED_AXES]
    at = se3.transform(T_base, centre[None])[0]
    starts = [AxisRotation(T_base[:3, :3], directions[k], points[k], at - points[k], size) for k in shallow]
    touched = se3.transform(se3.inverse(T_base), touching) - centre
    R, c, residual = draw_motion_curves(starts, drawn, touched, statistics, frames, rng)
    T = se3.rigid(R, c - R @ centre)
    keys = np.linspace(0.0, frames - 1.0, min(N_KEYFRAMES, frames)).round()
    posed = _close_at_keyframes(grasper, T[keys.astype(int)], keys, np.arange(float(frames)))
    axis = Axis(residual.hinge.point, residual.hinge.direction, residual.angle)
    return InHand(T, axis, posed, drawn["duration"])


def draw_motion_measures(statistics: MotionStatistics, rng: np.random.Generator) -> dict[str, float]:
    """Draw the ``LOGNORMAL_MEASURES`` of one grasp, in SI units."""
    root = np.linalg.cholesky(statistics.log_covariance)
    while np.abs(z := rng.normal(size=len(LOGNORMAL_MEASURES))).max() > MAX_ABS_Z_SCORE:
        pass
    return dict(zip(LOGNORMAL_MEASURES, np.exp(statistics.log_mean + root @ z).tolist(), strict=True))


def draw_motion_curves(
    starts: Sequence[AxisRotation],
    drawn: dict[str, float],
    touched: Float[ndarray, "P 3"],
    statistics: MotionStatistics,
    frames: int,
    rng: np.random.Generator,
) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"], HingeResidual]:
    """Draw rotations and positions of the centre [m] that nearly follow a hinge; also return their residual.

    Args:
        starts: hinges of the drawn motions; the best hinge of the result may differ.
        drawn: numbers of ``draw_motion_measures``; the motion nearest in ``MOTION_SELECTION_MEASURES`` is taken.
        touched: the object's points in contact, relative to its centre [m].
        statistics: statistics with the spectra of the curves.
        frames: number of frames.
        rng: random generator.
    """
    best, least = None, np.inf
    sizes = np.array([drawn[name] for name in MOTION_SIZE_MEASURES])
    for k in range(MAX_MOTION_DRAWS):
        start = starts[k % len(starts)]
        R, c = _motion_about_hinge(start, sizes, statistics, frames, rng)
        values, residual = measure_motion(se3.rigid(R, c), np.zeros(3), start.size, touched, frames / drawn["duration"])
        with np.errstate(divide="ignore"):  # a motion that stands still is infinitely far off
            off = np.log([values[name] / drawn[name] for name in MOTION_SELECTION_MEASURES])
        far = float(np.sqrt(np.mean(np.where(np.isnan(off), MISSING_MEASURE_DEVIATION, off) ** 2)))
        if best is None or far < least:
            best, least = (R, c, residual), far
        if least < LOG_MEASURE_TOLERANCE:
            break
    assert best is not None
    return best


def _motion_about_hinge(
    start: AxisRotation, sizes: Float[ndarray, "3"], statistics: MotionStatistics, frames: int, rng: np.random.Generator
) -> tuple[Float[ndarray, "N 3 3"], Float[ndarray, "N 3"]]:
    axes = hinge_axes(start.direction, start.arm)
    angle = _random_curves(statistics.angle, frames, 1, rng)[:, 0]
    rotation = _random_curves(statistics.rotation, frames, 3, rng) * np.sqrt(statistics.rotation_shares) @ axes.T
    place = _random_curves(statistics.place, frames, 3, rng) * np.sqrt(statistics.place_shares) @ axes.T
    towards, bent = axes[:, 1:] @ rng.normal(size=2), statistics.quantiles["bend"][MOTION_PERCENTILES.index(50)]
    scale = sizes / [np.ptp(angle), *(np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in (rotation, place))]
    hinge = start
    for k in range(N_CORRECTION_ITERATIONS):
        R, c = start.at(scale[0] * angle)
        R, c = se3.exp_so3(scale[1] * rotation) @ R, c + scale[2] * place
        hinge = nearby_hinge(hinge, R, c)
        residual = HingeResidual.beside(hinge, R, c)
        scale = scale * sizes / residual.sizes
        if k < N_CORRECTION_ITERATIONS - N_SIZE_ONLY_ITERATIONS:
            place = _equalise_spectrum(place, residual.place, statistics.place)
            rotation = _equalise_spectrum(rotation, residual.rotation, statistics.rotation)
            rotation = _bend_rotation(rotation, angle, bent - parabola_share(residual), towards)
    return R, c


def _equalise_spectrum(
    drawn: Float[ndarray, "T 3"], found: Float[ndarray, "T 3"], wanted: Sequence[float]
) -> Float[ndarray, "T 3"]:
    """Amplify a curve's frequencies that the residual lacks, since the best hinge absorbs some."""
    from scipy.fft import dct, idct

    gain = np.sqrt(np.array(wanted) / np.maximum(spectrum(found), 1e-6)).clip(0.7, 1.4)
    each = gain[np.minimum(np.arange(len(drawn) - 1), len(gain) - 1)]
    amplitudes = dct(drawn, axis=0, norm="ortho")
    amplitudes[1:] *= each[:, None]
    return np.asarray(idct(amplitudes, axis=0, norm="ortho"))


def _bend_rotation(
    rotation: Float[ndarray, "T 3"], angle: Float[ndarray, "T"], share: float, towards: Float[ndarray, "3"]
) -> Float[ndarray, "T 3"]:
    """Bend a rotation, so that the axis drifts: the square of the angle gets a share, if above zero."""
    powers = np.vander(angle - angle.mean(), 3)
    parabola = powers[:, 0] - powers[:, 1:] @ np.linalg.lstsq(powers[:, 1:], powers[:, 0], rcond=None)[0]
    more = np.sqrt(max(0.0, share) * np.sum(rotation**2) / (np.sum(parabola**2) * np.sum(towards**2)))
    return rotation + more * parabola[:, None] * towards


def _random_curves(
    wanted: Sequence[float], frames: int, count: int, rng: np.random.Generator
) -> Float[ndarray, "T count"]:
    """Random curves of a spectrum (``stable_grasps.axis.spectrum``); its last share is spread over all faster modes."""
    from scipy.fft import idct

    last = len(wanted) - 1
    shares = np.zeros(max(frames - 1, last + 1))
    shares[:last] = wanted[:last]
    shares[last:] = wanted[last] / len(shares[last:])
    amplitudes = np.zeros((frames, count))
    towards = rng.normal(size=(frames - 1, count))
    amplitudes[1:] = np.sqrt(shares[: frames - 1, None]) * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return np.asarray(idct(amplitudes, axis=0, norm="ortho"))


def _close_at_keyframes(
    grasper: Grasper, T_keys: Float[ndarray, "K 4 4"], keys: Float[ndarray, "K"], at: Float[ndarray, "T"]
) -> PosedHand:
    """Close the fingers about the object in the key poses, and interpolate them in between."""
    closed = grasper.close(T_keys)
    if grasper.thumb_miss(closed, T_keys) > MAX_HOLD_GAP_M:
        grasper = grasper.steered(closed, T_keys)
        closed = grasper.close(T_keys)
    bent = np.stack([np.interp(at, keys, joint) for joint in closed.reshape(len(keys), 15).T], axis=-1)
    return grasper.posed(bent.reshape(-1, 5, 3))


def _contact_vertices(grasper: Grasper, T_base: Float[ndarray, "4 4"]) -> Float[ndarray, "P 3"]:
    """Vertices of the closed hand in contact with the object in its base pose [m]."""
    closed = grasper.posed(grasper.close(T_base[None]))
    gap = grasper.distance(se3.transform(se3.inverse(T_base), closed.vertices[0]))
    return np.asarray(closed.vertices[0][gap < 0.003])


def _turning_depth(
    grasper: Grasper,
    T_base: Float[ndarray, "4 4"],
    points: Float[ndarray, "A 3"],
    directions: Float[ndarray, "A 3"],
    turn: float,
) -> Float[ndarray, "A"]:
    """Depth to which the object turns into the open hand, about each axis [m]."""
    ends = np.array([-0.5, 0.5]) * turn
    T = se3.rotation_about_line(points[:, None], directions[:, None], ends) @ T_base
    opened = grasper.opened().vertices
    least = MinSignedDistance(grasper.distance, T[..., 0, 0].size, se3.transform(se3.inverse(T_base), opened))
    turned = se3.transform(se3.inverse(T), opened).reshape(-1, *opened.shape)
    return np.asarray(-least(turned, np.arange(len(turned))).reshape(-1, 2).min(axis=1))


def _turning_axis(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], options: SceneOptions, rng: np.random.Generator
) -> Axis:
    """Choose the line near the contacts about which the object turns least deep into the open hand."""
    directions = rng.normal(size=(N_CANDIDATE_AXES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = _contact_vertices(grasper, T_base).mean(axis=0) + rng.normal(0.0, 0.008, (N_CANDIDATE_AXES, 3))
    curve = draw_smooth_curves(rng, options.frames, 1)[:, 0]
    curve = (curve - curve.min()) / np.ptp(curve) - 0.5
    least, most = np.radians(options.turn_deg)
    turn = rng.uniform(least, most)
    while True:  # the turn shrinks if it leads deep into the hand about every axis
        depth = _turning_depth(grasper, T_base, points, directions, turn)
        best = int(np.argmin(depth))
        if depth[best] < MAX_TURN_DEPTH_M or turn <= least:
            return Axis(points[best], directions[best], turn * curve)
        turn = max(0.8 * turn, least)
