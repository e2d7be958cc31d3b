"""How the object moves in the hand, and how the fingers follow it.

``draw_hinge_motion``: about one axis near the contacts (Eq. 3 of the paper), with a small smooth residual: almost what is fitted.

``draw_measured_motion``: as objects moved in the hands of real people. Drawn from ``MOTION_STATISTICS`` are how far the object
turns, how far it is off its best hinge, how long that takes, how far the axis drifts and is from the contacts, and how
far the contacts slip; so are the shares of slow and of fast motion. Of many random motions, each scaled to the drawn
sizes, the one is taken of which ``stable_grasps.axis`` measures the drawn numbers.

The view of a head-worn camera of a hand that carries something, and of the other hand that comes in front.
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
"""Measured on real grasps by ``benchmarks/motion.py``, last in commit ea913fa."""
MOTION_STATISTICS = {
    name: MotionStatistics(**row)
    for name, row in json.loads(MEASURED_MOTION_FILE.read_text(encoding="utf-8"))["statistics"].items()
}
"""How objects move in the hand in stable grasps, by dataset; SI units."""
MAX_TURN_DEPTH_M = 0.0035
"""How deep the object may turn into the open hand [m], where the turn is not measured."""
N_CANDIDATE_AXES = 24
"""Axes to choose from."""
N_KEYFRAMES = 7
"""Frames in which fingers are closed about a measured motion; between them they move evenly."""
MAX_ABS_Z_SCORE = 2.0
"""No drawn number is further from the mean than this, in standard deviations."""
N_CORRECTION_ITERATIONS, N_SIZE_ONLY_ITERATIONS = 6, 2
"""Rounds of correcting a drawn motion, and the number of last ones that correct its sizes only."""
N_TRIED_AXES = 6
"""Number of axes that are tried: those about which the object turns the least deep into the open hand."""
MAX_MOTION_DRAWS, LOG_MEASURE_TOLERANCE = 40, 0.1
"""Motions that are drawn until what is measured of one is as close as this to what is asked for, as logarithms."""
MOTION_SIZE_MEASURES = ("turn", "rotation", "place")
"""Measures that motions are scaled to, as ``Residual.sizes``."""
MOTION_SELECTION_MEASURES = (*MOTION_SIZE_MEASURES, "drift", "pivot", "slip")
"""Measures by which one of the motions is chosen."""
MISSING_MEASURE_DEVIATION = 1.0
"""Deviation of a motion without a measure, since it hardly turns."""


def draw_egocentric_poses(
    T_hand_obj: Float[ndarray, "4 4"],
    middle: Float[ndarray, "3"],
    diameter: float,
    frames: int,
    rng: np.random.Generator,
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
    """Draw ``T_world_cam`` and ``T_world_hand`` of a hand that lifts, carries and tilts, before a head that follows it.

    World: x right, y ahead, z up, the middle of hand and object near the origin. The object starts upright, turned
    such that the forearm comes from the right shoulder.
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
    moves = rotate_about_point(
        np.zeros(3), 0.2 * draw_smooth_curves(rng, frames, 3), 0.03 * draw_smooth_curves(rng, frames, 3)
    )
    return se3.transform(se3.rigid(None, place) @ moves, vertices @ (turn @ facing).T)


def draw_smooth_curves(rng: np.random.Generator, frames: int, curves: int) -> Float[ndarray, "T curves"]:
    """Draw random slow curves with values in [-1, 1]: a few low frequencies over the clip."""
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
    """The object in the hand over a clip.

    Attributes:
        T_hand_obj: (T, 4, 4) its poses.
        axis: the axis that it turns about; of a measured motion, that of its best hinge.
        posed: the hand that holds it.
        duration: time that it takes [s]; None: as long as the clip's frames last.
    """

    T_hand_obj: Float[ndarray, "T 4 4"]
    axis: Axis
    posed: PosedHand
    duration: float | None


def draw_hinge_motion(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], options: SceneOptions, rng: np.random.Generator
) -> InHand:
    """Make a motion that is nearly a rotation about one axis."""
    axis = _turning_axis(grasper, T_base, options, rng)
    line = se3.rotation_about_line(axis.point, axis.direction, axis.angle)
    residual = rotate_about_point(
        axis.point,
        np.radians(options.residual_deg) * draw_smooth_curves(rng, options.frames, 3),
        1e-3 * options.residual_mm * draw_smooth_curves(rng, options.frames, 3),
    )
    keys = np.linspace(axis.angle.min(), axis.angle.max(), 5)
    posed = _close_at_keyframes(
        grasper, se3.rotation_about_line(axis.point, axis.direction, keys) @ T_base, keys, axis.angle
    )
    return InHand(residual @ line @ T_base, axis, posed, None)


def draw_measured_motion(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], grasped: Mesh, frames: int, rng: np.random.Generator
) -> InHand:
    """Draw a motion from the statistics of one of the datasets in ``MOTION_STATISTICS``."""
    statistics = list(MOTION_STATISTICS.values())[rng.integers(len(MOTION_STATISTICS))]
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
    """Draw the numbers of one grasp, in SI units: the measures of ``LOGNORMAL_MEASURES``."""
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
    """Draw rotations and positions of the centre [m] about nearly a hinge, with some spectra.

    Also return their residual.

    Args:
        starts: hinges to begin with; ``stable_grasps.axis`` may find others in what is made of them.
        drawn: what it is to measure, as ``draw_motion_measures`` gives it: of some random motions, the nearest to that in ``MOTION_SELECTION_MEASURES``.
        touched: points of the object that are in contact, from its centre [m].
        statistics: the spectra.
        frames: length.
        rng: what chance decides.
    """
    best, least = None, np.inf
    sizes = np.array([drawn[name] for name in MOTION_SIZE_MEASURES])
    for k in range(MAX_MOTION_DRAWS):
        start = starts[k % len(starts)]
        R, c = _motion_about_hinge(start, sizes, statistics, frames, rng)
        values, residual = measure_motion(se3.rigid(R, c), np.zeros(3), start.size, touched, frames / drawn["duration"])
        off = np.log([values[name] / drawn[name] for name in MOTION_SELECTION_MEASURES])
        far = float(np.sqrt(np.mean(np.where(np.isnan(off), MISSING_MEASURE_DEVIATION, off) ** 2)))
        if best is None or far < least:
            best, least = (R, c, residual), far
        if least < LOG_MEASURE_TOLERANCE:
            break
    assert best is not None
    return best


def _motion_about_hinge(
    start: AxisRotation,
    sizes: Float[ndarray, "3"],
    statistics: MotionStatistics,
    frames: int,
    rng: np.random.Generator,
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
    """Amplify a curve's frequencies where less of them is found than wanted: the best hinge takes some."""
    from scipy.fft import dct, idct

    gain = np.sqrt(np.array(wanted) / np.maximum(spectrum(found), 1e-6)).clip(0.7, 1.4)
    each = gain[np.minimum(np.arange(len(drawn) - 1), len(gain) - 1)]
    amplitudes = dct(drawn, axis=0, norm="ortho")
    amplitudes[1:] *= each[:, None]
    return np.asarray(idct(amplitudes, axis=0, norm="ortho"))


def _bend_rotation(
    rotation: Float[ndarray, "T 3"], angle: Float[ndarray, "T"], share: float, towards: Float[ndarray, "3"]
) -> Float[ndarray, "T 3"]:
    """Bend a rotation by a share that goes with the square of the angle, if it is above zero: so the axis drifts."""
    powers = np.vander(angle - angle.mean(), 3)
    parabola = powers[:, 0] - powers[:, 1:] @ np.linalg.lstsq(powers[:, 1:], powers[:, 0], rcond=None)[0]
    more = np.sqrt(max(0.0, share) * np.sum(rotation**2) / (np.sum(parabola**2) * np.sum(towards**2)))
    return rotation + more * parabola[:, None] * towards


def _random_curves(
    wanted: Sequence[float], frames: int, count: int, rng: np.random.Generator
) -> Float[ndarray, "T count"]:
    """Random curves of a spectrum (``stable_grasps.axis.spectrum``), its last share spread over all that is faster."""
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
    """Close the hand's fingers about the object in some poses, and interpolate them in between."""
    closed = grasper.close(T_keys)
    if grasper.thumb_miss(closed, T_keys) > MAX_HOLD_GAP_M:
        grasper = grasper.steered(closed, T_keys)
        closed = grasper.close(T_keys)
    bent = np.stack([np.interp(at, keys, joint) for joint in closed.reshape(len(keys), 15).T], axis=-1)
    return grasper.posed(bent.reshape(-1, 5, 3))


def _contact_vertices(grasper: Grasper, T_base: Float[ndarray, "4 4"]) -> Float[ndarray, "P 3"]:
    """Return the vertices of the hand that touch the object in its base pose [m]."""
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
    """How deep the object turns into the open hand about some axes [m]."""
    ends = np.array([-0.5, 0.5]) * turn
    T = se3.rotation_about_line(points[:, None], directions[:, None], ends) @ T_base
    opened = grasper.opened().vertices
    least = MinSignedDistance(grasper.distance, T[..., 0, 0].size, se3.transform(se3.inverse(T_base), opened))
    turned = se3.transform(se3.inverse(T), opened).reshape(-1, *opened.shape)
    return np.asarray(-least(turned, np.arange(len(turned))).reshape(-1, 2).min(axis=1))


def _turning_axis(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], options: SceneOptions, rng: np.random.Generator
) -> Axis:
    """Find a line near the contacts about which the object can turn with the shortest path into the open hand."""
    directions = rng.normal(size=(N_CANDIDATE_AXES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = _contact_vertices(grasper, T_base).mean(axis=0) + rng.normal(0.0, 0.008, (N_CANDIDATE_AXES, 3))
    curve = draw_smooth_curves(rng, options.frames, 1)[:, 0]
    curve = (curve - curve.min()) / np.ptp(curve) - 0.5
    least, most = np.radians(options.turn_deg)
    turn = rng.uniform(least, most)
    while True:  # a smaller turn where every axis leads deep into the hand
        depth = _turning_depth(grasper, T_base, points, directions, turn)
        best = int(np.argmin(depth))
        if depth[best] < MAX_TURN_DEPTH_M or turn <= least:
            return Axis(points[best], directions[best], turn * curve)
        turn = max(0.8 * turn, least)
