"""DexYCB's files: the published layout and packed files; malformed files are refused."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands.model import mirrored
from getagrip.readers.datasets.dexycb import dexycb_files as files
from getagrip.readers.datasets.dexycb.dexycb_files import find_dexycb_sequences, infer_hand_side
from getagrip.readers.datasets.realsense import read_colour_intrinsics as intrinsics_of
from getagrip.readers.datasets.tracks import subject_from_clip_name
from helpers.dexycb_files import (
    FRAMES,
    HELD,
    INTRINSICS,
    META,
    SEQUENCE,
    SERIALS,
    SUBJECT,
    packed,
    read,
    scene,
    write_extrinsics,
)
from helpers.environment import DATA, needs


@pytest.mark.slow
def test_the_camera_that_sees_most_is_taken(root, own):
    folder = root / SUBJECT / SEQUENCE
    _, first, _ = own
    path = folder / SERIALS[1] / f"labels_{FRAMES - 1:06d}.npz"
    label = dict(np.load(path))
    label["seg"][:] = 14
    np.savez(path, **label)
    (recording,) = (s.read() for s in find_dexycb_sequences(root))
    assert recording.camera == SERIALS[1]
    assert first.object.any()


@pytest.mark.slow
def test_a_packed_file_holds_the_same(own, pack):
    folder, meshes = pack
    own, _, _ = own
    for at, subjects in ((folder, [SUBJECT, "20200813-subject-02"]), (folder / "sequences.npz", [SUBJECT])):
        found = [clip for clip, _ in islice(read(at, meshes), len(subjects))]
        assert [subject_from_clip_name(clip.name) for clip in found] == subjects
        for clip in found:
            assert (clip.side, clip.category, clip.frames) == (own.side, own.category, own.frames)
            np.testing.assert_allclose(clip.truth.T_cam_obj, own.truth.T_cam_obj, atol=1e-6)
            np.testing.assert_allclose(clip.hand.vertices, own.hand.vertices, atol=1e-4)
            np.testing.assert_allclose(clip.hand.T_cam_hand, own.hand.T_cam_hand, atol=1e-4)


def test_the_table_is_the_world_where_extrinsics_are_there(root):
    """Of the camera that is taken, from its pose and the tag's, both in the frame of another camera."""
    T_master_cam = se3.rigid(se3.exp_so3(np.array([0.3, -0.2, 0.1])), np.array([0.5, 0.1, -0.2]))
    T_master_tag = se3.rigid(se3.exp_so3(np.array([2.0, 0.4, -0.3])), np.array([0.1, 0.3, 1.2]))
    path = write_extrinsics(root, T_master_cam, T_master_tag)
    (sequence,) = find_dexycb_sequences(root)
    T_table_cam = sequence.read().T_table_cam
    np.testing.assert_allclose(T_master_tag @ T_table_cam, T_master_cam, atol=1e-12)
    write_extrinsics(root, 1.1 * T_master_cam, T_master_tag)
    with pytest.raises(InputError, match=rf"extrinsics.{SERIALS[0]} must be .*got a matrix that is not a rigid"):
        sequence.read()
    path.write_text("extrinsics: {}")
    with pytest.raises(InputError, match="must be 12 numbers"):
        sequence.read()


def test_bent_fingers_determine_the_hand():
    _, _, joints = scene()
    assert infer_hand_side(joints) == "right"
    assert infer_hand_side(mirrored(joints)) == "left"


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("meta.yml", "num_frames: 32", "num_frames: 33"),
        ("meta.yml", "num_frames: 32", "num_frames: many"),
        ("meta.yml", "- 14", "- 22"),
        ("meta.yml", "ycb_grasp_ind: 1", "ycb_grasp_ind: 2"),
        ("meta.yml", "- right", "- both"),
        ("meta.yml", "- '836212060125'\n- '932122062010'", "- ../../secret"),
        ("meta.yml", "ycb_ids:\n- 2\n- 14", "ycb_ids: 14"),
        ("meta.yml", META, "- 1"),
        ("meta.yml", META, "a: [1"),
        ("meta.yml", "ycb_ids:\n- 2\n- 14", "a: &a [2, 14]\nycb_ids: *a"),
        ("meta.yml", META, "a: !!python/object/apply:os.system ['true']"),
        ("836212060125_640x480.yml", "fx: 616.6", "fx: -1"),
        ("836212060125_640x480.yml", "ppy: 248.5", "ppy: .nan"),
        ("836212060125_640x480.yml", "color:", "colour:"),
        ("836212060125_640x480.yml", INTRINSICS, "[" * 5000),
    ],
)
@pytest.mark.slow
def test_broken_descriptions_are_named(root, name, old, new):
    (path,) = root.rglob(name)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError):
        list(read(root))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("joint_3d", np.zeros((1, 20, 3), np.float32)),
        ("joint_3d", np.full((1, 21, 3), np.nan, np.float32)),
        ("joint_3d", np.zeros((1, 21, 3), np.float32)),
        ("pose_y", np.zeros((1, 3, 4), np.float32)),
        ("pose_y", np.ones((2, 3, 4), np.float32)),
        ("pose_y", np.array([None])),
        ("pose_y", None),
    ],
)
def test_broken_labels_are_named(root, key, value):
    path = root / SUBJECT / SEQUENCE / SERIALS[0] / "labels_000007.npz"
    label = dict(np.load(path))
    label[key] = value
    np.savez(path, **{k: v for k, v in label.items() if v is not None})
    with pytest.raises(InputError):
        list(read(root))


def test_missing_files_are_named(root):
    next((root / "models" / HELD).iterdir()).unlink()
    with pytest.raises(InputError, match="025_mug"):
        list(read(root))
    with pytest.raises(UsageError, match="nowhere"):
        list(read(root, root / "nowhere"))
    with pytest.raises(InputError, match="nowhere"):
        list(read(root / "nowhere", root / "models"))
    with pytest.raises(InputError, match="models"):
        list(read(root / "models", root / "models"))


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("offset", np.array([0, 2 * FRAMES, FRAMES]), "offset"),
        ("offset", np.array([0, 2 * FRAMES]), "offset"),
        ("object", np.array([HELD]), "object"),
        ("object", np.array([HELD, "../../etc"]), "object"),
        ("sequence", np.array(["subject", "subject"]), "sequence"),
        ("sequence", np.array(["a/b", "../b"]), "sequence"),
        ("obj_quat_xyzw", np.ones((2 * FRAMES, 4)), "obj_quat_xyzw"),
        ("obj_trans", np.ones((2 * FRAMES, 4)), "obj_trans"),
        ("joints", np.full((2 * FRAMES, 21, 3), np.inf), "joints"),
        ("joints", np.ones((2 * FRAMES, 21, 3)), "wrist to middle knuckle"),
        ("hand_valid", np.ones(2 * FRAMES), "hand_valid"),
        ("hand_valid", np.array([{}]), "hand_valid"),
    ],
)
def test_broken_packed_files_are_named(pack, key, value, named):
    folder, meshes = pack
    np.savez(folder / "sequences.npz", **packed(**{key: value}))
    with pytest.raises(InputError, match=named):
        list(read(folder, meshes))


def test_sequences_of_absurd_lengths_are_refused(pack, monkeypatch):
    monkeypatch.setattr(files, "MAX_SEQUENCE_FRAMES", FRAMES - 1)
    with pytest.raises(InputError, match=f"offset must be .*got a sequence of {FRAMES} frames"):
        find_dexycb_sequences(pack[0])


@needs(DATA / "frame")
def test_real_labels_and_intrinsics_are_read():
    poses, joints = files._read_label(DATA / "frame" / "labels.npz", 4)
    assert se3.is_rigid(np.concatenate([poses, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (4, 1, 1))], axis=1)).all()
    K = intrinsics_of(DATA / "frame" / "836212060125_640x480.yml")
    label = np.load(DATA / "frame" / "labels.npz")
    uv = joints @ K.T
    np.testing.assert_allclose(uv[:, :2] / uv[:, 2:] - 0.5, label["joint_2d"][0], atol=1e-3)
