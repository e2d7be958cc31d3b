"""Fisheye624: known points are where they should be, without distortion and with it, and images agree."""

import csv

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.fisheye import Fisheye624, pinhole
from helpers.environment import DATA, needs

HOT3D = DATA / "hot3d"
SIZE = (640, 480)


def lens(scale=1.0):
    """A lens with every kind of distortion; none for scale 0."""
    k = [0.05, -0.04, 0.02, -0.01, 0.003, -0.0004]
    return Fisheye624.from_parameters(
        [240.0, 318.0, 237.0, *(scale * np.array([*k, 4e-4, -7e-4, 2e-3, -1e-3, 1.5e-3, 5e-4]))], SIZE
    )


def rays_within(degrees, n=200):
    rng = np.random.default_rng(0)
    theta, phi = np.radians(degrees) * rng.random(n), 2 * np.pi * rng.random(n)
    return np.stack([np.tan(theta) * np.cos(phi), np.tan(theta) * np.sin(phi), np.ones(n)], axis=-1)


def test_depth_along_the_ray_does_not_matter():
    rays = rays_within(60)
    np.testing.assert_allclose(lens().project(0.3 * rays), lens().project(rays), atol=1e-9)


def test_without_distortion_the_angle_is_the_radius():
    uv = lens(0.0).project(rays_within(80)) - lens(0.0).c
    angle = np.arccos(1.0 / np.linalg.norm(rays_within(80), axis=1))
    np.testing.assert_allclose(np.linalg.norm(uv, axis=1), 240.0 * angle, atol=1e-9)


def test_a_known_point():
    # Summed by hand from the equations for theta = 0.5 along x: m = (0.5 * radial, 0).
    camera = lens()
    t2 = 0.25
    m = 0.5 * (1 + 0.05 * t2 - 0.04 * t2**2 + 0.02 * t2**3 - 0.01 * t2**4 + 0.003 * t2**5 - 0.0004 * t2**6)
    u = m + 3 * 4e-4 * m**2 + 2e-3 * m**2 - 1e-3 * m**4
    v = -7e-4 * m**2 + 1.5e-3 * m**2 + 5e-4 * m**4
    expected = [240 * u + 318.5, 240 * v + 237.5]
    np.testing.assert_allclose(camera.project(np.array([np.tan(0.5), 0.0, 1.0])), expected, atol=1e-9)


def test_two_focal_lengths_are_read_as_one():
    one = [500.0, 320.0, 240.0, *np.zeros(12)]
    np.testing.assert_array_equal(
        Fisheye624.from_parameters([500.0, *one], SIZE).c, Fisheye624.from_parameters(one, SIZE).c
    )


@pytest.mark.parametrize("bad", [[], [1.0] * 14, [0.0] * 15, [np.nan] + [1.0] * 14])
def test_bad_parameters_are_refused(bad):
    with pytest.raises(ValueError, match="15 or 16 finite numbers"):
        Fisheye624.from_parameters(bad, SIZE)


@pytest.mark.slow
def test_undistorted_images_agree_with_the_pinhole():
    # An image whose value is a smooth function of the pixel: the pinhole's must be that of where its own rays fall.
    camera = lens()

    def paint(uv):
        return (np.sin(uv[..., 0] / 60.0) + 2.0).astype(np.float32)

    uv = np.stack(np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5), axis=-1)
    view = pinhole(camera, 240.0, (300, 200))
    image = view.undistort(camera, paint(uv))
    rays = np.concatenate([(uv[:200, :300] - view.K[:2, 2]) / 240.0, np.ones((200, 300, 1))], axis=-1)
    np.testing.assert_allclose(image, paint(camera.project(rays)), atol=1e-3)
    assert view.covered(camera).all()
    wide = pinhole(camera, 40.0, (640, 480)).covered(camera)  # 83 degrees to the left
    assert wide[240, 320]
    assert not wide[240, 0]


def test_a_quarter_turn_turns_the_picture_clockwise():
    camera = Fisheye624.from_parameters([240.0, 319.5, 239.5, *np.zeros(12)], SIZE)
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
    straight = pinhole(camera, 200.0, (60, 40)).undistort(camera, image)
    turned = pinhole(camera, 200.0, (40, 60), quarter_turns=1).undistort(camera, image)
    assert np.abs(turned.astype(int) - np.rot90(straight, -1)).max() <= 1
    np.testing.assert_allclose(
        pinhole(camera, 200.0, (60, 40), quarter_turns=4).T_fisheye_pinhole, np.eye(4), atol=1e-12
    )


@needs(HOT3D)
@pytest.mark.slow
def test_objects_of_hot3d_fall_into_the_published_boxes():
    from getagrip.readers.datasets.hot3d.hot3d_clips import Hot3dObjects
    from getagrip.readers.datasets.hot3d.hot3d_files import find_hot3d_recordings, read_recording

    objects = Hot3dObjects.below(HOT3D)
    for (name, files), stream in zip(find_hot3d_recordings(HOT3D).items(), ("1201-1", "214-1"), strict=True):
        recording = read_recording(name, files)
        meshes = objects.read(recording, print)
        camera = recording.camera
        T_fisheye_world = camera.pinhole.T_fisheye_pinhole @ se3.inverse(camera.T_world_cam)
        errors = []
        for row in csv.DictReader(files["box2d_objects.csv"].read_text().splitlines()):
            n = np.flatnonzero(recording.times == int(row["timestamp[ns]"]))
            if row["stream_id"] != stream or len(n) == 0 or not row["x_min[pixel]"]:
                continue
            X = se3.transform(
                T_fisheye_world[n[0]] @ recording.objects[row["object_uid"]].T_world_obj[n[0]],
                meshes[row["object_uid"]].vertices,
            )
            uv = camera.fisheye.project(X)
            box = np.array([float(row[f"{side}[pixel]"]) for side in ("x_min", "y_min", "x_max", "y_max")])
            errors.append(np.abs(np.concatenate([uv.min(axis=0), uv.max(axis=0)]) - box))
        assert len(errors) > 50
        assert np.median(errors) < 2.5  # their factory calibration against our online one; decimated meshes
