"""The DexYCB reader: on small files of exactly its layout, on broken ones, and on real ones where they are."""

import shutil
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.batch.imports import import_clips
from getagrip.clip import read_clip, read_masks
from getagrip.datasets.cutting import clip as clip_of
from getagrip.datasets.cutting import pieces
from getagrip.datasets.dataset import clips
from getagrip.datasets.dexycb import recording as files
from getagrip.datasets.dexycb.calibration import intrinsics as intrinsics_of
from getagrip.datasets.dexycb.reader import WITHIN_10_MM, DexYcb, fit_hand
from getagrip.datasets.dexycb.recording import PACKED_K, ObjectPoses, Recording, bent_side, find
from getagrip.datasets.tracks import subject_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.depth import depth_and_face
from getagrip.hands import generic
from getagrip.hands.model import mirrored
from helpers.dexycb_files import (
    FRAMES,
    HELD,
    INTRINSICS,
    LOST,
    META,
    NAME,
    SEQUENCE,
    SERIALS,
    SUBJECT,
    TAKEN,
    grip,
    packed,
    scene,
    write_dexycb,
    write_models,
    write_sequence,
)
from helpers.paths import DATA, needs


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """DexYCB's own layout, in which nothing may be changed."""
    return write_dexycb(tmp_path_factory.mktemp("dexycb"))


@pytest.fixture
def root(kept, tmp_path):
    """The same, to be broken."""
    return shutil.copytree(kept, tmp_path, dirs_exist_ok=True)


@pytest.fixture(scope="module")
def own(kept):
    """The one clip of it and its masks, and what was noted."""
    notes = []
    ((clip, masks),) = read(kept, note=notes.append)
    return clip, masks, notes


@pytest.fixture
def pack(tmp_path):
    """A folder with a packed file, and the folder of meshes."""
    write_models(tmp_path / "ycb")
    (tmp_path / "packed").mkdir()
    np.savez(tmp_path / "packed" / "sequences.npz", **packed())
    return tmp_path / "packed", tmp_path / "ycb"


def read(root, meshes=None, note=lambda _: None):
    """The clips of the stable grasps."""
    return clips(DexYcb(root=root, meshes=meshes), note)


def grasps(sequence, note=lambda _: None):
    """The stable grasps of a sequence, as pieces of its track."""
    return list(pieces(sequence.read(note), note, WITHIN_10_MM.cut(note)))


@pytest.mark.slow
def test_a_stable_grasp_becomes_a_clip(own):
    clip, masks, notes = own
    assert (clip.name, clip.category, clip.side, clip.scale) == (NAME, HELD, "right", "known")
    assert clip.frames == tuple(f"{n:06d}" for n in range(TAKEN, LOST))
    np.testing.assert_allclose(clip.K[3], [[616.6, 0, 309.0], [0, 616.2, 249.0], [0, 0, 1]])
    T_cam_hand, T_cam_obj, joints = scene()
    np.testing.assert_allclose(clip.truth.T_cam_obj, T_cam_obj[TAKEN:LOST], atol=1e-6)
    fitted = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    assert np.linalg.norm(fitted - joints[TAKEN:LOST], axis=-1).max() < 0.003
    turn = se3.angle_between(clip.hand.T_cam_hand[:, :3, :3], T_cam_hand[TAKEN:LOST, :3, :3])
    assert np.degrees(turn).max() < 2.0
    assert clip.provenance["subject"] == SUBJECT
    assert "CC BY-NC 4.0" in clip.provenance["licence"]
    assert "fitted" in clip.provenance["hands"]
    assert clip.provenance["camera"] == SERIALS[0]
    np.testing.assert_allclose(clip.times, np.arange(TAKEN, LOST) / 30.0)
    assert clip.world is None  # no extrinsics are there
    assert masks.object.shape == masks.ignore.shape == (LOST - TAKEN, 480, 640)
    assert notes == []


@pytest.mark.slow
def test_masks_are_the_object_less_what_hides_it(own):
    clip, masks, _ = own
    ball = se3.transform(clip.truth.T_cam_obj[0], clip.mesh.vertices)
    hand = se3.transform(clip.hand.T_cam_hand[0], clip.hand.vertices[0])
    of_ball, of_hand = (
        depth_and_face(v, f, clip.K[0], clip.size)[0] for v, f in ((ball, clip.mesh.faces), (hand, clip.hand.faces))
    )
    np.testing.assert_array_equal(masks.object[0], of_ball < of_hand)
    np.testing.assert_array_equal(masks.ignore[0], of_hand < of_ball)
    np.testing.assert_array_equal(masks.hand, masks.ignore)
    assert masks.object[0].any()
    assert masks.ignore[0].any()


@pytest.mark.slow
def test_other_objects_in_front_are_ignored(root):
    for path in (root / SUBJECT / SEQUENCE / SERIALS[0]).iterdir():
        label = dict(np.load(path))
        label["pose_y"][0, :, 3] = label["pose_y"][1, :, 3] * 0.6 + [0.05, 0.0, 0.0]
        np.savez(path, **label)
    ((clip, masks),) = read(root)
    box = trimesh.creation.box(extents=[0.06, 0.16, 0.21])
    centre = 0.6 * clip.truth.T_cam_obj[0, :3, 3] + [0.05, 0.0, 0.0]
    seen = depth_and_face(np.asarray(box.vertices) + centre, np.asarray(box.faces), clip.K[0], clip.size)[1] >= 0
    assert seen.sum() > 1000
    assert masks.ignore[0][seen].all()
    assert not (masks.hand & ~masks.ignore).any()
    assert not masks.hand[0][seen].any()


@pytest.mark.slow
def test_the_camera_that_sees_most_is_taken(root, own):
    folder = root / SUBJECT / SEQUENCE
    _, first, _ = own
    path = folder / SERIALS[1] / f"labels_{FRAMES - 1:06d}.npz"
    label = dict(np.load(path))
    label["seg"][:] = 14
    np.savez(path, **label)
    (recording,) = (s.read() for s in find(root))
    assert recording.camera == SERIALS[1]
    assert first.object.any()


@pytest.mark.slow
def test_a_packed_file_holds_the_same(own, pack):
    folder, meshes = pack
    own, _, _ = own
    for at, subjects in ((folder, [SUBJECT, "20200813-subject-02"]), (folder / "sequences.npz", [SUBJECT])):
        found = [clip for clip, _ in islice(read(at, meshes), len(subjects))]
        assert [subject_of(clip.name) for clip in found] == subjects
        for clip in found:
            assert (clip.side, clip.category, clip.frames) == (own.side, own.category, own.frames)
            np.testing.assert_allclose(clip.truth.T_cam_obj, own.truth.T_cam_obj, atol=1e-6)
            np.testing.assert_allclose(clip.hand.vertices, own.hand.vertices, atol=1e-4)
            np.testing.assert_allclose(clip.hand.T_cam_hand, own.hand.T_cam_hand, atol=1e-4)


def write_extrinsics(root, T_master_cam, T_master_tag):
    folder = root / "calibration" / "extrinsics_20200702_151821"
    folder.mkdir(exist_ok=True)
    rows = {SERIALS[0]: T_master_cam, SERIALS[1]: np.eye(4), "apriltag": T_master_tag}
    text = f"master: '{SERIALS[1]}'\nextrinsics:\n"
    for key, T in rows.items():
        text += f"  '{key}': {T[:3].ravel().tolist()}\n"
    (folder / "extrinsics.yml").write_text(text)
    return folder / "extrinsics.yml"


def test_the_table_is_the_world_where_extrinsics_are_there(root):
    """Of the camera that is taken, from its pose and the tag's, both in the frame of another camera."""
    T_master_cam = se3.rigid(se3.exp_so3(np.array([0.3, -0.2, 0.1])), np.array([0.5, 0.1, -0.2]))
    T_master_tag = se3.rigid(se3.exp_so3(np.array([2.0, 0.4, -0.3])), np.array([0.1, 0.3, 1.2]))
    path = write_extrinsics(root, T_master_cam, T_master_tag)
    (sequence,) = find(root)
    T_table_cam = sequence.read().T_table_cam
    np.testing.assert_allclose(T_master_tag @ T_table_cam, T_master_cam, atol=1e-12)
    write_extrinsics(root, 1.1 * T_master_cam, T_master_tag)
    with pytest.raises(InputError, match=f"{path}: extrinsics.{SERIALS[0]}: got a matrix that is no rigid motion"):
        sequence.read()
    path.write_text("extrinsics: {}")
    with pytest.raises(InputError, match="expected 12 numbers"):
        sequence.read()


def test_bent_fingers_determine_the_hand():
    _, _, joints = scene()
    assert bent_side(joints) == "right"
    assert bent_side(mirrored(joints)) == "left"


@pytest.mark.slow
def test_a_mirrored_scene_gives_the_mirrored_hand(tmp_path, pack):
    _, meshes = pack
    flip = np.diag([-1.0, 1.0, 1.0])
    given = packed()
    R = flip @ se3.from_quaternion(np.roll(given["obj_quat_xyzw"], 1, axis=1).astype(float)) @ flip
    given["obj_quat_xyzw"] = np.roll(se3.quaternion(R), -1, axis=1)
    given["obj_trans"], given["joints"] = mirrored(given["obj_trans"]), mirrored(given["joints"])
    np.savez(tmp_path / "left.npz", **given)
    right, _ = next(read(pack[0], meshes))
    left, _ = next(read(tmp_path / "left.npz", meshes))
    assert (left.side, left.frames) == ("left", right.frames)
    np.testing.assert_allclose(left.hand.vertices, mirrored(right.hand.vertices), atol=1e-5)


@pytest.mark.slow
def test_grasps_end_where_the_hand_is_not_known(root):
    """What lies between two gaps is a grasp where it has 20 frames."""
    for lost, expected in ((LOST, [(TAKEN, LOST - 1)]), (8, [(9, FRAMES - 1)]), (18, [])):
        write_sequence(root, f"20200709_1500{lost:02d}", lost=(lost,))
        (sequence,) = (s for s in DexYcb(root=root).sources() if s.name.endswith(f"{lost:02d}"))
        found = grasps(sequence)
        assert [tuple(piece.track.numbers[[0, -1]]) for piece in found] == expected
        assert all(float(piece.stable_area.split()[0]) > 0.9 for piece in found)


@pytest.mark.slow
def test_a_hand_that_lets_go_gives_no_clip(root):
    for path in (root / SUBJECT / SEQUENCE / SERIALS[0]).iterdir():
        label = dict(np.load(path))
        label["pose_y"][1, 0, 3] += 0.3
        np.savez(path, **label)
    notes = []
    assert list(read(root, note=notes.append)) == []
    assert "no stable grasp of 20 frames" in notes[0]


@pytest.mark.slow
def test_an_object_outside_the_image_gives_no_clip(root):
    path = root / "calibration" / "intrinsics" / f"{SERIALS[0]}_640x480.yml"
    path.write_text(INTRINSICS.replace("308.5", "-2000.0"))
    notes = []
    assert list(read(root, note=notes.append)) == []
    assert "visible in fewer than 20 frames" in notes[0]


@pytest.mark.parametrize("size", [0.9, 1.0, 1.15])
def test_fingers_are_as_thick_as_the_hand_is_long(size):
    """Joints of the generic hand at another size: the fitted hand has that size, in girth as well."""
    shape = np.zeros(len(generic.SHAPES))
    shape[generic.SHAPES.index("size")] = size - 1.0
    posed, _ = grip(shape)
    T_cam_hand, T_cam_obj, _ = scene()
    joints = se3.transform(T_cam_hand, posed.joints)
    known = np.ones(FRAMES, dtype=bool)
    poses = {HELD: ObjectPoses(T_cam_obj, known)}
    recording = Recording(Path("x"), "s", "q", "", "right", HELD, poses, joints, known, PACKED_K)
    hand = fit_hand(recording)
    assert np.median(hand.residuals) < 0.002
    pads = hand.track.vertices[0][hand.track.regions["index"]]
    expected = posed.vertices[posed.regions["index"]]
    np.testing.assert_allclose(
        np.linalg.svd(pads - pads.mean(0))[1], np.linalg.svd(expected - expected.mean(0))[1], rtol=0.06
    )


def test_subjects_are_known_by_the_name():
    assert subject_of(NAME) == SUBJECT
    for name in ("mug-right-0001", "--a--b", ""):
        with pytest.raises(UsageError, match="no subject"):
            subject_of(name)


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
    monkeypatch.setattr(files, "MOST_FRAMES", FRAMES - 1)
    with pytest.raises(InputError, match=f"offset: got a sequence of {FRAMES} frames"):
        find(pack[0])


@pytest.mark.slow
def test_the_other_sequences_are_read_before_an_error_is_raised(root):
    broken = root / SUBJECT / "20200709_000000"
    broken.mkdir()
    (broken / "meta.yml").write_text("a: [1")
    found = read(root)
    assert next(found)[0].name == NAME
    with pytest.raises(InputError, match="20200709_000000"):
        list(found)


@pytest.mark.slow
def test_import_writes_clips_and_goes_on_where_it_stopped(root, own, tmp_path, capsys):
    out = tmp_path / "out"
    assert import_clips(DexYcb(root=root), out, debug=False) == 0
    clip, masks, _ = own
    written = read_clip(out / NAME)
    assert written.frames == clip.frames
    np.testing.assert_allclose(written.truth.T_cam_obj, clip.truth.T_cam_obj)
    np.testing.assert_array_equal(read_masks(written).object, masks.object)
    stamp = (out / NAME / "hand.npz").stat().st_mtime_ns
    broken = root / SUBJECT / "20200709_000000"
    broken.mkdir()
    (broken / "meta.yml").write_text("a: [1")
    assert import_clips(DexYcb(root=root), out, debug=False) == 1
    printed = capsys.readouterr()
    assert "0 clips, 1 already there, 1 sequences failed" in printed.out
    assert "20200709_000000" in printed.err
    assert "Traceback" not in printed.err
    assert (out / NAME / "hand.npz").stat().st_mtime_ns == stamp


@needs(DATA / "frame")
def test_real_labels_and_intrinsics_are_read():
    poses, joints = files._label(DATA / "frame" / "labels.npz", 4)
    assert se3.is_rigid(np.concatenate([poses, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (4, 1, 1))], axis=1)).all()
    K = intrinsics_of(DATA / "frame" / "836212060125_640x480.yml")
    label = np.load(DATA / "frame" / "labels.npz")
    uv = joints @ K.T
    np.testing.assert_allclose(uv[:, :2] / uv[:, 2:] - 0.5, label["joint_2d"][0], atol=1e-3)


@needs(DATA / "dexycb")
@pytest.mark.slow
def test_real_sequences():
    sequences = find(DATA / "dexycb")
    recordings = [sequence.read() for sequence in sequences]
    assert len(recordings) == 162
    assert {r.side for r in recordings} == {"left"}
    sources = DexYcb(root=DATA / "dexycb", meshes=DATA / "ycb").sources()
    for n in (0, 24):
        (grasp,) = grasps(sources[n])
        clip, masks = clip_of(grasp, 20, print)
        assert len(clip) >= 20
        assert masks.object.any(axis=(1, 2)).all()
        assert np.sqrt(np.mean(grasp.track.residuals**2)) < 0.003
        assert 0.5 < float(grasp.stable_area.split()[0]) < 1.0
        true = recordings[n].joints[[int(f) for f in clip.frames]]
        fitted = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
        assert np.median(np.linalg.norm(fitted - true, axis=-1)) < 0.003


@pytest.mark.slow
def test_a_sequence_becomes_a_timeline(root):
    """Whole, with masks: the ball is held from frame ``TAKEN`` on; before, it moves with no hand near it."""
    table = write_extrinsics(root, np.eye(4), se3.rigid(None, np.array([0.0, 0.0, 1.0])))
    ((clip, masks),) = clips(DexYcb(root=root, timelines=True))
    assert clip.frames == tuple(f"{n:06d}" for n in range(FRAMES) if n != LOST)
    assert [(s.state, s.first, s.last, s.side) for s in clip.segments] == [
        ("free", 0, TAKEN - 1, None), ("grasp", TAKEN, len(clip) - 1, "right"),
    ]  # fmt: skip
    assert (clip.world.support, masks.object.any()) == (0.0, True)
    table.unlink()
    ((clip, _),) = clips(DexYcb(root=root, timelines=True))
    assert clip.world.up is None  # nothing else says where the table is
    with pytest.raises(UsageError, match="--timelines"):
        list(clips(DexYcb(root=root, timelines=True, whole=True)))


@pytest.mark.slow
@needs(DATA / "dexycb" / "left_hand_sequences.npz")
def test_real_objects_lie_on_a_table_that_the_others_show():
    dataset = DexYcb(root=DATA / "dexycb", meshes=DATA / "ycb", timelines=True)
    (draft,) = dataset.parts(lambda _: None)[20].drafts(lambda name, with_hands=False: True, lambda _: None)
    clip, _ = draft.make()
    states = [segment.state for segment in clip.segments]
    assert (states[0], "grasp" in states) == ("static", True)
    in_world = clip.world.T_world_cam @ clip.truth.T_cam_obj
    lowest = se3.transform(in_world, clip.mesh.vertices[None])[..., 2].min(axis=1)
    assert np.abs(lowest[clip.segments[0].rows]).max() < 0.01
    assert lowest[-1] > 0.05
