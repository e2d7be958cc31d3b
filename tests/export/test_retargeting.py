"""SPIDER and dex-retargeting: arrays as their programs read them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy import ndarray
from scipy.spatial.transform import Rotation

from getagrip.errors import UsageError
from getagrip.export import Scene, export
from getagrip.export.scene import StageFrame, palm_orientation
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import mirrored


def on_stage(scene: Scene) -> tuple[ndarray, ndarray]:
    T_stage_obj, T_stage_hand = StageFrame.of(scene).poses(scene)
    assert scene.joints is not None
    return T_stage_obj, se3.transform(T_stage_hand, scene.joints)


@pytest.mark.parametrize("side", ["left", "right"])
def test_spider_has_wrist_tips_and_object(scene: Scene, tmp_path: Path, side: str) -> None:
    scene = replace(scene, side=side, name="a mug/1")
    folder = export(scene, tmp_path / "out", "spider")
    task = folder / "processed" / "getagrip" / "mano" / side / "a-mug-1"
    info = json.loads((task / "task_info.json").read_text())
    assert info["ref_dt"] == pytest.approx(0.15)  # 7.2, 7.3, 7.5 s
    mesh = trimesh.load(folder / info[f"{side}_object_mesh_dir"] / "visual.obj", process=False)
    np.testing.assert_allclose(mesh.vertices, scene.object.vertices, atol=1e-6)
    other = "right" if side == "left" else "left"
    assert info[f"{other}_object_mesh_dir"] is None
    T_stage_obj, joints = on_stage(scene)
    with np.load(task / "0" / "trajectory_keypoints.npz") as data:  # without pickles
        shapes = {"wrist": (3, 7), "finger": (3, 5, 7), "obj": (3, 7)}
        for name, shape in shapes.items():
            given = data[f"qpos_{name}_{side}"], data[f"qpos_{name}_{other}"]
            assert given[0].shape == given[1].shape == shape
            np.testing.assert_allclose(np.linalg.norm(given[0][..., 3:], axis=-1), 1.0)
            assert (given[1] == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).all()
        np.testing.assert_allclose(data[f"qpos_finger_{side}"][..., :3], joints[:, 4::4])
        np.testing.assert_allclose(data[f"qpos_wrist_{side}"][:, :3], joints[:, 0])
        R = Rotation.from_quat(data[f"qpos_wrist_{side}"][:, 3:], scalar_first=True).as_matrix()
        reach = joints[:, 9] - joints[:, 0]
        np.testing.assert_allclose(R[:, :, 2], reach / np.linalg.norm(reach, axis=1, keepdims=True), atol=1e-9)
        q = data[f"qpos_obj_{side}"]
        np.testing.assert_allclose(q[:, :3], T_stage_obj[:, :3, 3])
        R = Rotation.from_quat(q[:, 3:], scalar_first=True).as_matrix()
        np.testing.assert_allclose(R, T_stage_obj[:, :3, :3], atol=1e-9)
        np.testing.assert_array_equal(data["timestamps"], np.round(1e9 * scene.time))
        assert data["frame_kind"].tolist() == ["sampled", "fitted", "interpolated"]
        np.testing.assert_array_equal(data["T_world_obj"], scene.T_world_obj)


@pytest.mark.parametrize("side", ["left", "right"])
def test_dex_retargeting_has_joints_and_object_poses(scene: Scene, tmp_path: Path, side: str) -> None:
    scene = replace(scene, side=side)
    folder = export(scene, tmp_path / "out", "dex-retargeting")
    T_stage_obj, joints = on_stage(scene)
    with np.load(folder / "trajectory.npz") as data:
        np.testing.assert_allclose(data["joint_pos"], joints)
        q = data["object_pose"]
        assert q.shape == (3, 1, 7)
        np.testing.assert_allclose(q[:, 0, 4:], T_stage_obj[:, :3, 3])
        np.testing.assert_allclose(Rotation.from_quat(q[:, 0, :4]).as_matrix(), T_stage_obj[:, :3, :3], atol=1e-9)
        np.testing.assert_array_equal(data["extrinsics"], np.eye(4))
        about = data["joint_pos_wrist"]
        np.testing.assert_allclose(about[:, 0], 0.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(about, axis=2), np.linalg.norm(joints - joints[:, :1], axis=2))
        np.testing.assert_allclose(about[:, 9, :2], 0.0, atol=1e-9)  # the middle knuckle lies on z
        assert str(data["hand_type"]) == side
    mesh = trimesh.load(folder / "object.obj", process=False)
    np.testing.assert_allclose(mesh.vertices, scene.object.vertices, atol=1e-6)


def test_the_palm_of_a_left_hand_is_the_mirror_image() -> None:
    """Of a right hand with its palm down, y is towards the thumb; a left hand's x and y are turned round."""
    joints = generic.load("right").with_shape().with_pose().joints[None]
    right, left = palm_orientation(joints, "right", 9), palm_orientation(mirrored(joints), "left", 9)
    for R in (right, left):
        np.testing.assert_allclose(R[0] @ R[0].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R[0]) == pytest.approx(1.0)
    assert (joints[0, 4] - joints[0, 20]) @ right[0, :, 1] > 0.0
    assert mirrored(joints[0, 4] - joints[0, 20]) @ left[0, :, 1] < 0.0
    np.testing.assert_allclose(left[0, :, 2], mirrored(right[0, :, 2]), atol=1e-12)


@pytest.mark.parametrize("to", ["spider", "dex-retargeting"])
def test_hands_without_joints_are_refused(scene: Scene, tmp_path: Path, to: str) -> None:
    with pytest.raises(UsageError, match=f"missing joints in hand.npz of the clip small: --to {to}"):
        export(replace(scene, joints=None), tmp_path / "out", to)
    assert not list(tmp_path.iterdir())
