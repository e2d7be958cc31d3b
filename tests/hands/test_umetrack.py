"""The UmeTrack hand: against a loop over vertices, laws of mirrors and hinges, and HOT3D's own hands where they are."""

import json

import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import umetrack
from getagrip.hands.generic import MANO_WRIST_M
from getagrip.hands.model import PALM_REGIONS, SIDE_MIRROR, root_transform
from helpers.environment import DATA, needs
from helpers.hand_object_files import profile

HOT3D = DATA / "hot3d"


def loaded(tmp_path, changes=None):
    made = profile()
    made["hand_model"].update(changes or {})
    path = tmp_path / "profile.json"
    path.write_text(json.dumps(made))
    return umetrack.load(path)


def skinned_reference(model, angles):
    """Every vertex by itself, in the wrist frame [m]."""
    pivots, axes = np.array(model["joint_rest_positions"]) / 1e3, np.array(model["joint_rotation_axes"])
    bones = [np.eye(4), np.eye(4)]
    for finger in range(5):
        T = np.eye(4)
        for hinge in range(4 * finger, 4 * finger + 4):
            R = se3.exp_so3(axes[hinge] * angles[hinge])
            local = np.eye(4)
            local[:3, :3], local[:3, 3] = R, pivots[hinge] - R @ pivots[hinge]
            T = T @ local
            if hinge % 4:
                bones.append(T)
    points = np.array(model["mesh_vertices"]) / 1e3
    out = []
    for x, weights in zip(points, np.array(model["dense_bone_weights"]), strict=True):
        out.append(sum(w * (B @ [*x, 1.0]) for w, B in zip(weights, bones, strict=True))[:3])
    return np.array(out)


def test_skinning_equals_the_reference(tmp_path):
    angles = np.random.default_rng(0).normal(size=(3, 22))
    posed = loaded(tmp_path).with_pose("left", angles)
    T_wrist_hand = umetrack.T_world_hand("left", np.eye(4))
    for n in range(3):
        expected = skinned_reference(profile()["hand_model"], angles[n])
        np.testing.assert_allclose(se3.transform(T_wrist_hand, posed.vertices[n]), expected, atol=1e-12)


def test_a_right_hand_is_the_left_one_in_the_mirror(tmp_path):
    hand, angles = loaded(tmp_path), np.random.default_rng(1).normal(size=22)
    left, right = hand.with_pose("left", angles), hand.with_pose("right", angles)
    np.testing.assert_allclose(right.vertices, left.vertices * SIDE_MIRROR)
    np.testing.assert_allclose(right.joints, left.joints * SIDE_MIRROR)
    np.testing.assert_array_equal(right.faces, left.faces[:, ::-1])
    # In the world: HOT3D poses the mirrored mesh by the wrist.
    T_world_wrist = se3.rigid(se3.exp_so3(np.array([0.3, -1.0, 0.4])), np.array([0.1, 0.2, 0.3]))
    expected = se3.transform(T_world_wrist, skinned_reference(profile()["hand_model"], angles) * SIDE_MIRROR)
    ours = se3.transform(umetrack.T_world_hand("right", T_world_wrist), right.vertices)
    np.testing.assert_allclose(ours, expected, atol=1e-12)


@pytest.mark.slow
def test_joints_are_the_hinges(tmp_path):
    hand = loaded(tmp_path)
    rest = hand.with_pose("left", np.zeros(22))
    turned = np.zeros(22)
    turned[15] = 0.7  # the last hinge of the ring finger moves its tip and nothing else
    bent = hand.with_pose("left", turned)
    moved = np.flatnonzero(np.linalg.norm(bent.joints - rest.joints, axis=1) > 1e-9)
    np.testing.assert_array_equal(moved, [16])
    np.testing.assert_allclose(rest.joints[0], MANO_WRIST_M * SIDE_MIRROR)
    lengths = np.linalg.norm(np.diff(rest.joints[1:].reshape(5, 4, 3), axis=1), axis=-1)
    angles = hand.with_pose("left", np.random.default_rng(2).normal(size=22))
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(angles.joints[1:].reshape(5, 4, 3), axis=1), axis=-1), lengths, atol=1e-12
    )


def test_the_mesh_is_closed_and_outward(tmp_path):
    hand = loaded(tmp_path)
    assert hand.rest.is_closed
    assert hand.rest.volume > 0
    inward = np.array(profile()["hand_model"]["mesh_triangles"])[:, ::-1].tolist()
    assert loaded(tmp_path, {"mesh_triangles": inward}).rest.volume > 0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mesh_vertices", [[0.0, 1.0]]),
        ("mesh_vertices", "vertices"),
        ("mesh_triangles", [[0, 1, 100000]]),
        ("mesh_triangles", [[0, 1, 1.5]]),
        ("dense_bone_weights", [[1.0] * 17]),
        ("joint_rest_positions", [[0.0, 0.0, None]] * 22),
        ("joint_rotation_axes", None),
    ],
)
def test_bad_profiles_are_refused_by_name(tmp_path, key, value):
    with pytest.raises(InputError, match=r"profile\.json: .*" + key):
        loaded(tmp_path, {key: value})


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"hand_model": 3}', '{"hand_model": NaN}'])
def test_files_that_are_no_profile_are_refused(tmp_path, text):
    path = tmp_path / "profile.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"profile\.json"):
        umetrack.load(path)


@needs(HOT3D)
@pytest.mark.parametrize("path", sorted(HOT3D.rglob("umetrack_hand_user_profile.json")), ids=lambda p: p.parent.name)
def test_a_real_hand_lies_in_the_hand_frame(path):
    hand = umetrack.load(path)
    posed = hand.with_pose("right", np.zeros(22))
    wrist, middle, index, pinky = posed.joints[[0, 9, 5, 17]]
    towards = (middle - wrist) / np.linalg.norm(middle - wrist)
    assert towards[0] < -0.98  # fingers to -x
    across = np.cross(towards, index - pinky)
    assert -across[1] / np.linalg.norm(across) < -0.9  # thumb side at +z, back of the hand at +y
    assert hand.rest.is_closed
    assert 0.2e-3 < hand.rest.volume < 0.7e-3
    assert list(posed.regions) == [*FINGERS, *PALM_REGIONS]
    for n, finger in enumerate(FINGERS):
        assert 8 <= len(posed.regions[finger]) <= 30
        pad, tip = posed.vertices[posed.regions[finger]], posed.joints[4 * n + 4]
        assert np.linalg.norm(pad - tip, axis=1).max() < 0.035
        if finger != "thumb":
            assert posed.normals[posed.regions[finger], 1].mean() < -0.5  # palm to -y
    everything = np.concatenate(list(posed.regions.values()))
    assert len(everything) == len(np.unique(everything))
    curled = hand.with_pose("right", np.array([0, 0, 0, 0, *[0, 0.8, 0.8, 0.5] * 4, 0, 0]))
    assert np.all(curled.joints[8::4, 1] < posed.joints[8::4, 1] - 0.02)  # fingers bend towards the palm


@needs(HOT3D)
def test_the_hand_frame_agrees_with_mano():
    turns, distances = [], []
    for path in sorted(HOT3D.rglob("umetrack_hand_pose_trajectory.jsonl")):
        wrists = []
        for file in (path, path.with_name("mano_hand_pose_trajectory.jsonl")):
            hands = json.loads(file.read_text().splitlines()[0])["hand_poses"]
            poses = [hands[key]["wrist_xform"] for key in ("0", "1")]
            wrists.append([(se3.from_quaternion(np.array(p["q_wxyz"])), np.array(p["t_xyz"])) for p in poses])
        for ours, mano, side, root, axial in zip(
            *wrists,
            ("left", "right"),
            (MANO_WRIST_M * SIDE_MIRROR, MANO_WRIST_M),
            (np.ones(3), -SIDE_MIRROR),
            strict=True,
        ):
            T_world_hand = umetrack.T_world_hand(side, se3.rigid(*ours))
            T_hand_mano = se3.inverse(T_world_hand) @ root_transform(*mano, root)
            turns.append(np.degrees(se3.log_so3(T_hand_mano[:3, :3])) * axial)
            distances.append(1e3 * np.linalg.norm(se3.transform(T_hand_mano, root[None])[0] - root))
    assert np.linalg.norm(turns, axis=1).max() < 5.0
    assert max(distances) < 8.0
    assert np.linalg.norm(np.mean(turns, axis=0)) < 0.5  # the constants are the mean over these hands
