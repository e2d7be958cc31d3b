"""Measured motion: drawn motions have the stored statistics, the ground truth is what the masks show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import true_masks
from getagrip.stable_grasps.axis import (
    LOGNORMAL_MEASURES,
    MOTION_PERCENTILES,
    AxisRotation,
    measure_motion,
    parabola_share,
    spectrum,
)
from getagrip.synthetic.in_hand_motion import (
    MAX_ABS_Z_SCORE,
    MOTION_STATISTICS,
    draw_motion_curves,
    draw_motion_measures,
)
from getagrip.synthetic.objects import bottle, draw_deformation, misfit
from getagrip.synthetic.scene import make_scene, synthesise
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS
from helpers.measures import correlation_time

SMALL = replace(SYNTHETIC_PRESETS["measured"], frames=12, size=(160, 120), focal=150.0)
SIZE = 0.04
TOUCHED = np.array([0.0, 0.05, 0.0]) + 0.02 * np.concatenate([np.eye(3), -np.eye(3)])
"""Points in contact, from the object's centre."""


def moved(name: str, rng: np.random.Generator) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """What was drawn, and the motion of an object whose centre is 5 cm from the middle of the contact."""
    wanted = draw_motion_measures(MOTION_STATISTICS[name], rng)
    around = rng.normal(size=(6, 2, 3))
    directions = around[:, 0] / np.linalg.norm(around[:, 0], axis=1, keepdims=True)
    off = np.cross(directions, around[:, 1])
    points = wanted["pivot"] * off / np.linalg.norm(off, axis=1, keepdims=True)
    pairs = zip(directions, points, strict=True)
    starts = [
        AxisRotation(np.eye(3), direction, point, -TOUCHED.mean(axis=0) - point, SIZE) for direction, point in pairs
    ]
    R, c, _ = draw_motion_curves(starts, wanted, TOUCHED, MOTION_STATISTICS[name], 30, rng)
    return wanted, R, c


@pytest.mark.parametrize("name", MOTION_STATISTICS)
def test_drawn_numbers_have_the_stored_mean_and_quantiles(name: str) -> None:
    statistics, rng = MOTION_STATISTICS[name], np.random.default_rng(0)
    grasps = [draw_motion_measures(statistics, rng) for _ in range(2000)]
    logs = np.log([[grasp[key] for key in LOGNORMAL_MEASURES] for grasp in grasps])
    deviation = np.sqrt(np.diag(statistics.log_covariance))
    np.testing.assert_allclose(logs.mean(axis=0), statistics.log_mean, atol=0.1 * deviation.max())
    cut = 0.88  # what is left of a deviation where more than UNUSUAL is left out
    assert MAX_ABS_Z_SCORE == 2.0
    np.testing.assert_allclose(logs.std(axis=0), cut * deviation, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(logs.T), _correlation(statistics.log_covariance), atol=0.07)
    for key in LOGNORMAL_MEASURES:  # the quantiles were measured apart from the normal law
        middle = np.percentile([grasp[key] for grasp in grasps], 50)
        assert middle == pytest.approx(statistics.quantiles[key][MOTION_PERCENTILES.index(50)], rel=0.2), key


def _correlation(covariance: tuple[tuple[float, ...], ...]) -> np.ndarray:
    d = np.sqrt(np.diag(covariance))
    return np.array(covariance) / np.outer(d, d)


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTION_STATISTICS)
def test_drawn_motions_are_measured_as_they_were_drawn(name: str) -> None:
    statistics, rng = MOTION_STATISTICS[name], np.random.default_rng(1)
    spectra, memory, bends, chosen = [], [], [], []
    for _ in range(4):
        wanted, R, c = moved(name, rng)
        values, residual = measure_motion(se3.rigid(R, c), np.zeros(3), SIZE, TOUCHED, 30.0 / wanted["duration"])
        for key in ("duration", "turn", "rotation", "place"):
            assert values[key] == pytest.approx(wanted[key], rel=0.2), key
        spectra.append([spectrum(residual.angle[:, None]), spectrum(residual.rotation), spectrum(residual.place)])
        memory.append(correlation_time(residual.rotation, 30.0 / wanted["duration"]))
        bends.append(parabola_share(residual))
        chosen.append(np.log([values[key] / wanted[key] for key in ("drift", "pivot", "slip")]))
    stored = [statistics.angle, statistics.rotation, statistics.place]
    np.testing.assert_allclose(np.cumsum(np.mean(spectra, axis=0), axis=1), np.cumsum(stored, axis=1), atol=0.15)
    for key, found in (("rotation_memory", memory), ("bend", bends)):  # few are drawn: where most measured ones lie
        assert statistics.quantiles[key][0] < np.median(found) < statistics.quantiles[key][-1], key
    spread = np.sqrt(np.diag(statistics.log_covariance))[
        [LOGNORMAL_MEASURES.index(key) for key in ("drift", "pivot", "slip")]
    ]
    assert (np.nanmedian(np.abs(chosen), axis=0) < 0.5 * spread).all()  # each is nearer than chance would have it


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_a_deformation_leaves_what_no_similarity_undoes(share: float) -> None:
    mesh = bottle()
    deformed = Mesh(draw_deformation(mesh, share, np.random.default_rng(0))(mesh.vertices), mesh.faces)
    assert misfit(mesh, deformed) == pytest.approx(share * mesh.diameter, rel=0.1)
    assert deformed.volume > 0.5 * mesh.volume


@pytest.mark.slow
def test_the_masks_show_the_true_poses_and_the_cad_is_of_another_shape() -> None:
    scene = make_scene("box", 7, SMALL)
    clip, masks = synthesise("box", 7, replace(SMALL, mask_ragged_px=0.0))
    for n in (0, 5, 11):
        held = se3.transform(clip.truth.T_cam_obj[n], scene.object.vertices), scene.object.faces
        hand = se3.transform(clip.truth.T_cam_hand[n], clip.truth.hand_vertices[n]), clip.hand.faces
        shown, *_ = true_masks(held, [hand], [], clip.K[n], clip.size)
        np.testing.assert_array_equal(masks.object[n], shown)
    assert misfit(clip.mesh, scene.object) > 0.9 * SMALL.deform * scene.object.diameter
    assert clip.fps != SMALL.fps
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    line = se3.rotation_about_line(scene.axis.point, scene.axis.direction, scene.axis.angle - scene.axis.angle[0])
    off = se3.angle_between((line @ T[0])[:, :3, :3], T[:, :3, :3])
    assert np.degrees(off).max() > 1.0  # no hinge
