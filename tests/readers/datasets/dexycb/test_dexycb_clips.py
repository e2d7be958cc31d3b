"""DexYCB's clips and timelines: grasps, masks, the fitted hand, the table, and skipped data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.hands import generic
from getagrip.hands.model import mirrored
from getagrip.readers.datasets.cutting import clip_of_piece as clip_of
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb, fit_recording_hand, support_plane, world_of_plane
from getagrip.readers.datasets.dexycb.dexycb_files import (
    PACKED_K,
    DexYcbRecording,
    ObjectPoses,
    find_dexycb_sequences,
)
from getagrip.readers.datasets.tracks import subject_from_clip_name
from helpers.clips import box
from helpers.dexycb_files import (
    FRAMES,
    HELD,
    INTRINSICS,
    LOST,
    NAME,
    SEQUENCE,
    SERIALS,
    SUBJECT,
    TAKEN,
    grasps,
    grip,
    packed,
    read,
    scene,
    write_extrinsics,
    write_sequence,
)
from helpers.environment import DATA, needs


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
    assert "fitted" in str(clip.provenance["hands"])
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
    shape = np.zeros(len(generic.SHAPE_PARAMETER_NAMES))
    shape[generic.SHAPE_PARAMETER_NAMES.index("size")] = size - 1.0
    posed, _ = grip(shape)
    T_cam_hand, T_cam_obj, _ = scene()
    joints = se3.transform(T_cam_hand, posed.joints)
    known = np.ones(FRAMES, dtype=bool)
    poses = {HELD: ObjectPoses(T_cam_obj, known)}
    recording = DexYcbRecording(Path("x"), "s", "q", "", "right", HELD, poses, joints, known, PACKED_K)
    hand = fit_recording_hand(recording)
    assert np.median(hand.residuals) < 0.002
    pads = hand.track.vertices[0][hand.track.regions["index"]]
    expected = posed.vertices[posed.regions["index"]]
    np.testing.assert_allclose(
        np.linalg.svd(pads - pads.mean(0))[1], np.linalg.svd(expected - expected.mean(0))[1], rtol=0.06
    )


def test_subjects_are_known_by_the_name():
    assert subject_from_clip_name(NAME) == SUBJECT
    for name in ("mug-right-0001", "--a--b", ""):
        with pytest.raises(UsageError, match="clip's name must be"):
            subject_from_clip_name(name)


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
    assert "0 clips, 1 already there, 1 of 2 sequences failed" in printed.out
    assert "20200709_000000" in printed.err
    assert "Traceback" not in printed.err
    assert (out / NAME / "hand.npz").stat().st_mtime_ns == stamp
    assert import_clips(DexYcb(root=root), tmp_path / "some", debug=False, only={NAME}) == 0  # no other is read
    assert (tmp_path / "some" / NAME / "hand.npz").exists()


@needs(DATA / "dexycb")
@pytest.mark.slow
def test_real_sequences():
    sequences = find_dexycb_sequences(DATA / "dexycb")
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


@pytest.mark.parametrize("seed", range(3))
def test_the_plane_is_found_though_one_object_lies_on_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tilt = se3.exp_so3(rng.uniform(-0.2, 0.2, 3)) @ se3.exp_so3(np.array([np.radians(90.0 + 35.0), 0.0, 0.0]))
    up = tilt[:, 2]
    resting = []
    for n in range(9):
        size = rng.uniform(0.03, 0.2, 3)
        place = [*rng.uniform(-0.2, 0.2, 2), size[2] / 2 + (0.12 if n == 4 else 0.0)]
        on_table = box(*size).vertices @ se3.exp_so3(np.array([0.0, 0.0, rng.uniform(0.0, 6.0)])).T + place
        resting.append(on_table @ tilt.T + [0.0, 0.0, 0.8])
    normal, height = support_plane(resting)
    assert np.degrees(np.arccos(np.clip(normal @ up, -1.0, 1.0))) < 0.5
    assert height == pytest.approx(0.8 * up[2], abs=0.002)
    T_world_cam = world_of_plane(normal, height)
    assert se3.is_rigid(T_world_cam)
    lowest = [float(se3.transform(T_world_cam, points)[:, 2].min()) for points in resting]
    np.testing.assert_allclose(np.delete(lowest, 4), 0.0, atol=0.003)
    assert lowest[4] == pytest.approx(0.12, abs=0.003)
