"""The HOT3D reader: on a made-up recording, on broken ones, and on HOT3D's own samples where they are."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_umetrack import profile

from getagrip import se3
from getagrip.clip import FINGERS
from getagrip.datasets import hot3d
from getagrip.errors import InputError
from getagrip.kernels.depth import depth_and_face

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "hot3d"
NAME = "P0000_0123abcd"
FRAMES = 16
STEP = 33_333_333


@pytest.fixture
def root(tmp_path):
    """A right hand (a ball) that touches a box in frames 2 to 13, seen by a Quest; a second object has no mesh."""
    sequence = tmp_path / "sequences" / NAME
    sequence.mkdir(parents=True)
    times = 10**12 + STEP * np.arange(FRAMES)

    def poses(uid, offsets):
        return [
            [uid, t + 90_000, *x, 1, 0, 0, 0] for t, x in zip(times, np.broadcast_to(offsets, (FRAMES, 3)), strict=True)
        ]

    header = ["object_uid", "timestamp[ns]", "t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]", "q_wo_w", "q_wo_x", "q_wo_y"]
    header += ["q_wo_z"]
    # The hand's ball reaches from its wrist 12 cm to -x; the box begins there, but for the first and last frames.
    apart = np.where((np.arange(FRAMES) < 2) | (np.arange(FRAMES) > 13), 0.02, 0.0)
    box = np.stack([-0.122 - 0.04 - apart, np.zeros(FRAMES), np.full(FRAMES, 0.6)], axis=1)
    tables = {
        "headset_trajectory.csv": [[1, t, 0, 0, 0, 1, 0, 0, 0] for t in sorted([*times, *(times + 90_000)])],
        "dynamic_objects.csv": [*poses("111", box), *poses("222", [1.0, 0.0, 1.0])],
    }
    for name, rows in tables.items():
        with (sequence / name).open("w", newline="") as file:
            csv.writer(file).writerows([header, *rows])
    wrist = {"q_wxyz": [1, 0, 0, 0], "t_xyz": [0.0, 0.0, 0.6]}
    hands = {"1": {"wrist_xform": wrist, "joint_angles": [0.0] * 22}}
    lines = [json.dumps({"timestamp_ns": int(t), "hand_poses": hands}) for t in times]
    (sequence / "umetrack_hand_pose_trajectory.jsonl").write_text("\n".join(lines))
    (sequence / "umetrack_hand_user_profile.json").write_text(json.dumps(profile()))
    small, large = (
        {
            "T_Device_Camera": {"quaternion_wxyz": [1, 0, 0, 0], "translation_xyz": [0, 0, 0]},
            "imageHeight": height,
            "imageWidth": 640,
            "label": "camera-slam-left",
            "projectionParams": [300.0, 300.0, 319.5, height / 2 - 0.5, *[0.0] * 12],
        }
        for height in (480, 640)
    )
    (sequence / "camera_models.json").write_text(json.dumps([small, large]))
    assets = tmp_path / "assets"
    assets.mkdir()
    instances = {"111": {"instance_name": "red_box"}, "222": {"instance_name": "ghost"}}
    (assets / "instance.json").write_text(json.dumps(instances))
    trimesh.creation.box(extents=[0.08, 0.1, 0.12]).export(assets / "111.glb")
    return tmp_path


def test_a_hold_becomes_a_clip(root):
    notes = []
    ((clip, masks),) = hot3d.read(root, notes.append)
    assert clip.name == f"{NAME}-red_box-right"
    assert (clip.category, clip.side, clip.size, clip.scale) == ("red_box", "right", (640, 640), "known")
    assert clip.fps == pytest.approx(30.0, abs=0.01)
    assert clip.frames == tuple(f"{n:06d}" for n in range(2, 14))
    assert any("ghost" in note for note in notes)
    # One quarter turn: the world's x, right in the lens's picture, points down in ours.
    np.testing.assert_allclose(clip.truth.T_cam_obj[0, :3, 3], [0.0, -0.162, 0.6], atol=1e-12)
    # The hand is the mirrored ball, 12 cm to the world's -x.
    hand = se3.transform(clip.truth.T_cam_hand[0], clip.truth.hand_vertices[0])
    np.testing.assert_allclose(hand[:, 1].min(), -0.12, atol=1e-3)
    np.testing.assert_array_equal(clip.hand.T_cam_hand, clip.truth.T_cam_hand)
    # Object and hand do not overlap here, so the mask is the whole object.
    box = se3.transform(clip.truth.T_cam_obj[3], clip.mesh.vertices)
    seen = depth_and_face(box, clip.mesh.faces, clip.K[3], clip.size)[1] >= 0
    assert np.count_nonzero(seen) > 1000
    np.testing.assert_array_equal(masks.object[3] | masks.ignore[3], seen | masks.ignore[3])
    assert not np.any(masks.object & masks.ignore)
    assert masks.object.shape == masks.ignore.shape == (12, 640, 640)
    json.dumps(clip.provenance)


def test_files_may_lie_apart(root):
    apart = root / "hands" / NAME
    apart.mkdir(parents=True)
    for path in root.glob(f"sequences/{NAME}/umetrack*"):
        path.rename(apart / path.name)
    ((clip, _),) = hot3d.read(root)
    assert len(clip) == 12


def test_short_touches_are_no_holds(root):
    path = root / "sequences" / NAME / "umetrack_hand_pose_trajectory.jsonl"
    path.write_text("\n".join(path.read_text().splitlines()[:10]))  # contact in 8 frames; no hand after them
    assert list(hot3d.read(root)) == []


def test_the_other_recordings_are_read_before_an_error_is_raised(root):
    broken = root / "sequences" / "P0000_bad"
    broken.mkdir()
    (broken / "dynamic_objects.csv").write_text("object_uid\n")
    clips = hot3d.read(root)
    assert next(clips)[0].name.startswith(NAME)
    with pytest.raises(InputError, match="P0000_bad"):
        list(clips)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("dynamic_objects.csv", "t_wo_y[m]", "t_wo_y[mm]"),
        ("dynamic_objects.csv", "0.6", "nan"),
        ("dynamic_objects.csv", ",1,0,0,0", ",2,0,0,0"),
        ("headset_trajectory.csv", None, "object_uid\n"),
        ("umetrack_hand_pose_trajectory.jsonl", '"timestamp_ns"', '"time"'),
        ("umetrack_hand_pose_trajectory.jsonl", '"1"', '"2"'),
        ("umetrack_hand_pose_trajectory.jsonl", "[1, 0, 0, 0]", "[1, 0, 0]"),
        ("umetrack_hand_pose_trajectory.jsonl", "1000000000000", "1e999"),
        ("umetrack_hand_pose_trajectory.jsonl", None, "{"),
        ("umetrack_hand_pose_trajectory.jsonl", None, "[" * 100_000),
        ("umetrack_hand_user_profile.json", None, "{}"),
        ("camera_models.json", None, "[]"),
        ("camera_models.json", "640", "64000000"),
        ("camera_models.json", "300.0", "-300.0"),
    ],
)
def test_broken_files_are_named(root, name, old, new):
    path = root / "sequences" / NAME / name
    path.write_text(new if old is None else path.read_text().replace(old, new))
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        list(hot3d.read(root))


def test_missing_files_are_named(root):
    (root / "sequences" / NAME / "camera_models.json").unlink()
    with pytest.raises(InputError, match=r"camera_models\.json"):
        list(hot3d.read(root))
    (root / "assets" / "instance.json").unlink()
    with pytest.raises(InputError, match=r"instance\.json"):
        list(hot3d.read(root))
    with pytest.raises(InputError, match="no dynamic_objects"):
        list(hot3d.read(root / "assets"))
    with pytest.raises(InputError, match="no such folder"):
        list(hot3d.read(root / "nowhere"))


@pytest.mark.parametrize("name", ["../escape", "a/b", "", 3])
def test_object_names_that_could_be_paths_are_refused(root, name):
    (root / "assets" / "instance.json").write_text(json.dumps({"111": {"instance_name": name}}))
    with pytest.raises(InputError, match=r"instance\.json: 111"):
        list(hot3d.read(root))


@pytest.mark.skipif(not DATA.is_dir(), reason="needs HOT3D's samples in the folder 'shared' beside the checkout")
def test_the_three_holds_of_the_samples():
    from scipy.spatial import cKDTree

    notes = []
    found = {}
    for clip, masks in hot3d.read(DATA, notes.append):
        found[clip.name] = len(clip)
        assert masks.object.any(axis=(1, 2)).all()
        assert clip.truth.scale == 1.0
        hand = se3.transform(clip.truth.T_cam_hand, clip.truth.hand_vertices)
        corners = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices[clip.mesh.faces].mean(axis=1))
        for n in (0, len(clip) - 1):
            distance, _ = cKDTree(corners[n]).query(hand[n])
            pads = [distance[clip.hand.regions[finger]].min() for finger in FINGERS]
            assert sorted(pads)[2] < 0.008  # three fingertips and more are at the object
    assert found == {
        "P0002_273c2819-mouse-right": 15,
        "P0003_c701bd11-coffee_pot-left": 34,
        "P0003_c701bd11-mug_white-right": 34,
    }
    assert notes == []
