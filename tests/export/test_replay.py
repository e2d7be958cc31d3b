"""Replay: a grasp that stands still holds its object, one that is beside the hand does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from getagrip import SceneOptions, synthesise
from getagrip.errors import UsageError
from getagrip.export import Scene
from getagrip.export.replay import simulate_replay, split_hand_by_bones
from getagrip.export.scene import StageFrame
from getagrip.geometry import se3
from helpers.environment import needs_library
from helpers.results import true_result


@pytest.fixture(scope="module")
def grasp() -> Scene:
    """A box in a hand that moves, and does not move in it."""
    clip, _ = synthesise("box", 1, SceneOptions(frames=12))
    scene = Scene.of(true_result(clip, None), clip)
    return replace(scene, T_hand_obj=np.tile(scene.T_hand_obj[:1], (len(scene.frames), 1, 1)))


def dropped(scene: Scene, by: float) -> Scene:
    """The object moved to below the hand, to where it is farthest from it."""
    up = (StageFrame.of(scene).T_stage_cam @ scene.T_cam_hand)[0, 2, :3]
    points, hand = se3.transform(scene.T_hand_obj[0], scene.object.vertices), cKDTree(scene.hand_vertices[0])
    ways = np.random.default_rng(0).normal(size=(300, 3))
    ways = [way / np.linalg.norm(way) for way in ways if way @ up < 0.0]
    T = scene.T_hand_obj.copy()
    T[:, :3, 3] += by * max(ways, key=lambda way: hand.query(points + by * way)[0].min())
    return replace(scene, T_hand_obj=T)


@needs_library("mujoco", "mujoco")
@pytest.mark.slow
def test_a_grasp_holds_and_what_is_beside_the_hand_falls(grasp: Scene) -> None:
    held, fallen = simulate_replay(grasp), simulate_replay(dropped(grasp, 0.03))
    assert held.stays == 1.0
    assert fallen.stays < 0.2
    since = grasp.time[-1] - grasp.time[fallen.free][0]
    assert fallen.displacement[-1] > 0.5 * 9.81 * since**2 / 2.0
    np.testing.assert_array_equal(simulate_replay(grasp).displacement, held.displacement)
    assert "friction" in held.assumed


def test_parts_move_as_the_hand_does(grasp: Scene) -> None:
    parts, T = split_hand_by_bones(grasp)
    assert len(parts) == T.shape[1] == 20
    assert se3.is_rigid(T).all()
    turned = se3.rigid(se3.exp_so3(np.array([0.3, 1.0, -0.5])), np.array([0.1, 0.2, 0.3]))
    assert grasp.joints is not None
    moved = replace(
        grasp,
        hand_vertices=np.stack([grasp.hand_vertices[0], se3.transform(turned, grasp.hand_vertices[0])]),
        joints=np.stack([grasp.joints[0], se3.transform(turned, grasp.joints[0])]),
    )
    T = split_hand_by_bones(moved)[1]
    np.testing.assert_allclose(T[1], turned @ T[0], atol=1e-9)
    with pytest.raises(UsageError, match="joints"):
        split_hand_by_bones(replace(grasp, joints=None))


@needs_library("mujoco", "mujoco")
def test_one_frame_is_refused(grasp: Scene) -> None:
    one = replace(grasp, frames=grasp.frames[:1])
    with pytest.raises(UsageError, match="two frames"):
        simulate_replay(one)
