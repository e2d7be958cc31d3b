"""Initial poses: where the object is placed, and how large it is at first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import FINGERS, Clip, Masks
from getagrip.fitting.solver.initial_poses import grip_point, initial_poses
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions


@pytest.fixture(scope="module")
def made() -> tuple[Clip, Masks]:
    return synthesise("can", 0, SceneOptions(frames=6, scale="free"))


def grip(clip: Clip) -> np.ndarray:
    """The mean of the fingertips' contact regions, in the hand frame."""
    return np.mean([clip.hand.vertices[:, clip.hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS], axis=0)


def projected(clip: Clip, point: np.ndarray) -> np.ndarray:
    """Where a point of the hand frame is in each image [px]."""
    at = se3.transform(clip.hand.T_cam_hand, point[None, None])[:, 0]
    return np.array([project(K, x[None])[0] for K, x in zip(clip.K, at, strict=True)])


@pytest.mark.slow
def test_rays_through_the_grip_itself_give_the_grip(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    np.testing.assert_allclose(grip_point(clip.hand, clip.K, projected(clip, grip(clip))), grip(clip), atol=1e-9)


def test_rays_pull_the_point_off_the_grip_but_not_all_the_way(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    target = grip(clip) + np.array([0.0, -0.05, 0.02])
    uv = projected(clip, target)
    start, found, end = (projected(clip, x) for x in (grip(clip), grip_point(clip.hand, clip.K, uv), target))
    assert np.all(np.linalg.norm(found - end, axis=1) < 0.25 * np.linalg.norm(start - end, axis=1))
    assert np.all(np.linalg.norm(found - end, axis=1) > 0.0)


def test_the_camera_frame_does_not_matter(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    uv = projected(clip, grip(clip) + 0.03)
    about_the_eye = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 0.4])))
    R = about_the_eye[:2, :2]
    turned = replace(clip, hand=replace(clip.hand, T_cam_hand=about_the_eye @ clip.hand.T_cam_hand))
    centre = clip.K[:, :2, 2]
    np.testing.assert_allclose(
        grip_point(turned.hand, turned.K, (uv - centre) @ R.T + centre), grip_point(clip.hand, clip.K, uv), atol=1e-9
    )


def test_a_free_scale_gives_the_same_size_for_any_unit_of_the_mesh(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    assert clip.truth is not None
    doubled = replace(clip, mesh=replace(clip.mesh, vertices=2.0 * clip.mesh.vertices))
    one, other = (np.exp(initial_poses(c, masks, 3).log_scale) for c in (clip, doubled))
    np.testing.assert_allclose(one, 2.0 * other)
    assert np.all(np.abs(np.log(one / clip.truth.scale)) < np.log(1.5))


@pytest.mark.slow
def test_rotations_are_nearly_uniform(made: tuple[Clip, Masks]) -> None:
    for seed in (0, 7):
        R = initial_poses(*made, 400, seed).R
        np.testing.assert_allclose(R.mean(axis=0), 0.0, atol=0.02)
        angles = se3.angle_between(R[:, None], R[None]) + 10.0 * np.eye(400)
        assert angles.min(axis=1).max() < 2.5 * angles.min(axis=1).min()
