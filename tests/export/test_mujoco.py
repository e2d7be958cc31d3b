"""MuJoCo: its own library loads the scene, replays it exactly, and steps it without an explosion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip import SceneOptions, synthesise
from getagrip.export import Scene, export
from getagrip.export.mujoco import convex_decomposition
from getagrip.export.scene import BONE_END_JOINTS, Bones, StageFrame
from getagrip.geometry import se3
from helpers.clips import box
from helpers.environment import needs_library
from helpers.results import true_result

pytestmark = needs_library("mujoco", "mujoco")


def loaded(scene: Scene, folder: Path) -> tuple[Any, Any]:
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(export(scene, folder, "mujoco") / "scene.xml"))
    return model, mujoco.MjData(model)


def posed(data: Any, body: str) -> ndarray:
    return se3.rigid(data.body(body).xmat.reshape(3, 3), data.body(body).xpos)


@pytest.mark.slow
def test_keys_replay_every_frame(scene: Scene, tmp_path: Path) -> None:
    import mujoco

    model, data = loaded(scene, tmp_path / "out")
    T_stage_obj, T_stage_hand = StageFrame.of(scene).poses(scene)
    assert model.nkey == 3
    np.testing.assert_allclose(model.key_time, scene.time - scene.time[0], atol=1e-8)
    for n in range(model.nkey):
        mujoco.mj_resetDataKeyframe(model, data, n)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(posed(data, "object"), T_stage_obj[n], atol=1e-7)
        np.testing.assert_allclose(posed(data, "target"), T_stage_obj[n], atol=1e-7)
        joints = se3.transform(T_stage_hand[n], scene.joints[n])
        tips = [posed(data, model.body(f"bone_{name}").name) for name in ("index_1", "pinky_tip")]
        np.testing.assert_allclose(tips[0][:3, 3], joints[0], atol=1e-7)  # bones begin at the joint before
        np.testing.assert_allclose(tips[1][:3, 3], joints[19], atol=1e-7)
    assert model.body("object").mass[0] > 0.0


def test_bones_run_from_joint_to_joint(scene: Scene) -> None:
    bones = Bones.of(scene)
    assert bones is not None
    for n, (begin, end) in enumerate(BONE_END_JOINTS):
        span = scene.joints[:, end] - scene.joints[:, begin]
        length = np.linalg.norm(span, axis=1)
        np.testing.assert_allclose(bones.T_hand_bone[:, n, :3, 3], scene.joints[:, begin])
        np.testing.assert_allclose(bones.T_hand_bone[:, n, :3, 2] * length[:, None], span, atol=1e-12)
    assert se3.is_rigid(bones.T_hand_bone).all()


@pytest.mark.slow
def test_pieces_are_convex_and_make_up_the_object() -> None:
    cube = box(0.05, 0.07, 0.11)
    (piece,) = convex_decomposition(cube)
    assert piece.volume == pytest.approx(cube.volume, rel=0.1)
    flat = replace(cube, vertices=cube.vertices * [1.0, 1.0, 0.5], faces=cube.faces[:2])  # one side, no inside
    assert len(convex_decomposition(flat)) >= 1


@pytest.fixture(scope="module")
def held() -> Scene:
    """A spoon in a hand that turns it: the ground truth of a synthetic clip."""
    clip, _ = synthesise("spoon", 1, SceneOptions(frames=8, fps=15.0))
    return Scene.of(true_result(clip, None), clip)


@pytest.mark.slow
@pytest.mark.parametrize("follows", [True, False])
def test_a_stepped_simulation_does_not_explode(held: Scene, tmp_path: Path, follows: bool) -> None:
    import mujoco

    """With the weld, the object goes where the reconstruction has it; without, it may fall, and no faster."""
    model, data = loaded(held, tmp_path / "out")
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.eq_active[0] = follows
    speeds, off = [], []
    while data.time < model.key_time[-1]:
        at = np.searchsorted(model.key_time, data.time, side="right") - 1
        share = (data.time - model.key_time[at]) / (model.key_time[at + 1] - model.key_time[at])
        data.mocap_pos[:] = ((1 - share) * model.key_mpos[at] + share * model.key_mpos[at + 1]).reshape(-1, 3)
        turned = ((1 - share) * model.key_mquat[at] + share * model.key_mquat[at + 1]).reshape(-1, 4)
        data.mocap_quat[:] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        mujoco.mj_step(model, data)
        speeds.append(np.linalg.norm(data.qvel[:3]))
        off.append(np.linalg.norm(data.body("object").xpos - data.body("target").xpos))
    assert np.isfinite(data.qpos).all()
    assert not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
    assert max(speeds) < (1.0 if follows else 9.81 * data.time + 1.0)
    assert max(off) < (0.02 if follows else 9.81 * data.time**2 / 2.0 + 0.1)


@pytest.mark.slow
def test_a_hand_without_joints_is_its_mesh(scene: Scene, tmp_path: Path) -> None:
    import mujoco

    model, data = loaded(replace(scene, joints=None), tmp_path / "out")
    mujoco.mj_resetDataKeyframe(model, data, 2)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(posed(data, "hand"), StageFrame.of(scene).poses(scene)[1][2], atol=1e-7)
    assert (tmp_path / "out" / "assets" / "hand.obj").is_file()
