"""ArtiGrasp's copy of ARCTIC as tracks: its traps, on small files with known answers; and real ones if present."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import read_clip, write_clip
from getagrip.geometry import se3
from getagrip.geometry.mesh import subdivide_parts
from getagrip.geometry.mesh_files import read_mesh
from getagrip.readers.datasets import arctic, cutting
from getagrip.readers.datasets.track_files import Tracks
from getagrip.readers.datasets.tracks import Track
from helpers.environment import folder_of
from helpers.motion_capture_files import (
    ESTIMATE_WORLD,
    OPENED_BOX,
    SEQUENCE,
    TAKEN,
    recording,
    write_artigrasp,
    write_estimates,
)
from scripts.convert import artigrasp


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_artigrasp(tmp_path)


def tracks(root: Path, *options: str) -> Tracks:
    """What is converted."""
    artigrasp.main([str(root), str(root / "tracks"), *options])
    return Tracks(root=root / "tracks")


def read(root: Path, *options: str) -> list[Track]:
    """The tracks of the one sequence, the left hand's first."""
    (source,) = tracks(root, *options).sources()
    assert source.name == f"s1-{SEQUENCE}"
    return list(source.read(lambda _: None))


def template(root: Path) -> arctic.Template:
    """The box."""
    parts = [read_mesh(root / "rsc" / "arctic" / "box" / f"{part}_watertight_tiny.obj") for part in artigrasp.PARTS]
    mesh, part = subdivide_parts(parts)
    return arctic.make_neutral_template(mesh, part == 1)


@pytest.mark.slow
def test_wrong_frames_are_left_out_and_hands_are_where_they_are(root: Path) -> None:
    left, right = read(root)
    assert (left.side, right.side) == ("left", "right")
    of = recording()
    for track in (left, right):
        np.testing.assert_array_equal(track.numbers, np.arange(3, 64))
        assert "guess" in str(track.provenance["camera"])
        assert track.other_hand is not None
    T_hand_obj = se3.inverse(right.hand.T_cam_hand) @ right.T_cam_obj @ template(root).T_neutral_template
    expected = (se3.inverse(of.T_world_hand) @ of.T_world_obj)[right.numbers]
    np.testing.assert_allclose(T_hand_obj[:, :3, 3], expected[:, :3, 3], atol=5e-3)
    assert np.degrees(se3.angle_between(T_hand_obj[:, :3, :3], expected[:, :3, :3]).max()) < 5.0


@pytest.mark.slow
def test_the_object_is_in_metres_and_its_top_turns_about_minus_z(root: Path) -> None:
    right = read(root)[1]
    T_template_obj = se3.inverse(template(root).T_neutral_template)
    closed, opened = (se3.transform(T_template_obj, right.object(angle).vertices) for angle in (0.0, 0.5))
    assert np.ptp(closed, axis=0) == pytest.approx([0.07, 0.063, 0.05], abs=1e-9)
    turns = np.linalg.norm(opened - closed, axis=1) > 1e-9
    np.testing.assert_array_equal(turns, closed[:, 1] < -0.0255)  # the lid, no more
    np.testing.assert_allclose(opened[turns], closed[turns] @ se3.exp_so3(np.array([0.0, 0.0, 0.5])), atol=1e-9)
    moved = np.linalg.norm(np.diff((right.T_cam_obj @ template(root).T_neutral_template)[:, :3, 3], axis=0), axis=1)
    true = np.linalg.norm(np.diff(recording().T_world_obj[right.numbers, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(moved, true, atol=1e-6)  # a fixed camera keeps distances


@pytest.mark.slow
def test_meshes_have_enough_vertices_to_count_contact(root: Path) -> None:
    assert 2000 < len(read(root)[1].object(0.0).vertices) < 9000  # of boxes with 8 each


@pytest.mark.slow
def test_a_grasp_ends_where_the_joint_turns(root: Path) -> None:
    found = list(cutting.cut_into_grasps(read(root), print, tracks(root).cut(print)))
    spans = [(p.track.side, int(p.track.numbers[0]), int(p.track.numbers[-1])) for p in found]
    assert spans == [("right", TAKEN, OPENED_BOX - 1), ("right", OPENED_BOX, 63)]  # the left hand holds nothing
    provenance = found[0].track.describe(found[0])
    assert found[0].name == f"s1--{SEQUENCE}--box--right"
    assert "non-commercial" in provenance["licence"]
    assert "guess" in str(provenance["camera"])


def test_broken_files_are_skipped_by_name(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    joints = root / "rsc" / "mano_double" / "ee" / "s1" / f"{SEQUENCE}_l.npy"
    good = np.load(joints)
    for bad, key in ((good[:-1], "shape"), (good.astype(object), "Python objects")):
        np.save(joints, bad)
        artigrasp.main([str(root), str(root / "tracks")])
        said = capsys.readouterr().err
        assert key in said
        assert joints.name in said
    joints.unlink()
    artigrasp.main([str(root), str(root / "tracks")])
    assert "no such file" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="sequence"):
        artigrasp.main([str(root), str(root / "tracks"), "--subjects", "s2"])


@pytest.fixture
def estimated(root: Path) -> Path:
    return write_estimates(root)


def test_estimates_are_no_sequences(estimated: Path) -> None:
    assert [source.name for source in tracks(estimated).sources()] == [f"s1-{SEQUENCE}"]


@pytest.mark.slow
def test_estimated_hands_stand_by_the_true_object_as_by_the_estimated_one(estimated: Path) -> None:
    for track in read(estimated, "--estimated"):
        np.testing.assert_array_equal(track.numbers, np.arange(10, 60))
        assert track.input_hand is not None
        true, given = (
            se3.transform(hand.T_cam_hand, hand.joints) for hand in (track.hand, track.input_hand)
        )  # the same hand, fitted twice, nearer to the camera
        np.testing.assert_allclose(given - true, np.broadcast_to([0.0, 0.0, -0.01], true.shape), atol=4e-3)
        clip = cutting.clip_of_track(track)
        assert clip.truth is not None
        np.testing.assert_array_equal(clip.hand.T_cam_hand, track.input_hand.T_cam_hand)
        np.testing.assert_array_equal(clip.truth.T_cam_hand, track.hand.T_cam_hand)
        np.testing.assert_array_equal(track.take(np.arange(5)).input_hand.T_cam_hand, clip.hand.T_cam_hand[:5])
        T_cam_template = track.T_cam_obj @ template(estimated).T_neutral_template
        expected = ESTIMATE_WORLD @ recording().T_world_obj[track.numbers]
        assert np.degrees(se3.angle_between(T_cam_template[:, :3, :3], expected[:, :3, :3]).max()) < 1.0
        assert "estimated" in str(track.provenance["hands"])


@pytest.mark.slow
def test_the_estimated_object_of_each_clip_stands_at_the_true_place(estimated: Path, tmp_path: Path) -> None:
    clips, poses = tmp_path / "clips", tmp_path / "poses"
    for track in read(estimated, "--estimated"):
        write_clip(cutting.clip_of_track(track.take(np.arange(5, 25)), track.name), None, clips / track.name)
    artigrasp.main(["", str(estimated / "tracks"), "--poses", str(clips), str(poses)])
    for folder in sorted(clips.iterdir()):
        clip, stored = read_clip(folder), np.load(poses / f"{folder.name}.npz")
        assert clip.truth is not None
        assert tuple(stored["frames"]) == clip.frames
        T, S = stored["T_cam_obj"], clip.truth.T_cam_obj
        neutral = template(estimated).T_neutral_template[:3, 3]  # the template's origin, which is placed
        np.testing.assert_allclose(se3.transform(T, neutral[None]), se3.transform(S, neutral[None]), atol=1e-6)
        off = np.degrees(se3.angle_between(T[:, :3, :3], S[:, :3, :3]))
        assert 0.1 < off.mean() < 4.0


def test_estimates_of_too_few_frames_are_skipped(estimated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = estimated / "rsc" / "arctic" / "box" / "s1_recon" / f"{SEQUENCE}.object.npy"
    np.save(file, np.load(file)[:40])
    artigrasp.main([str(estimated), str(estimated / "tracks"), "--estimated"])
    assert "skipped" in capsys.readouterr().err
    file.unlink()
    with pytest.raises(SystemExit, match="sequence"):
        artigrasp.main([str(estimated), str(estimated / "tracks"), "--estimated"])


def test_the_median_rotation_does_not_heed_outliers() -> None:
    rng = np.random.default_rng(0)
    true = se3.exp_so3(rng.normal(size=3))
    near = se3.exp_so3(0.05 * rng.normal(size=(200, 3))) @ true
    far = se3.exp_so3(np.array([2.5, 0.0, 0.0]) + 0.05 * rng.normal(size=(80, 3))) @ true
    assert np.degrees(se3.angle_between(artigrasp.median_rotation(np.concatenate([far, near])), true)) < 3.0


def test_a_short_sequence_has_no_right_frame(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in root.rglob("*.npy"):
        np.save(file, np.load(file)[:31])
    artigrasp.main([str(root), str(root / "tracks")])
    assert "31 frames" in capsys.readouterr().err


@folder_of("GETAGRIP_ARTIGRASP")
def test_real_sequences(folder: Path, tmp_path: Path) -> None:
    artigrasp.main([str(folder), str(tmp_path), "--subjects", "s1"])
    sources = Tracks(root=tmp_path).sources()
    assert len(sources) >= 1
    for track in sources[0].read(print):
        assert len(track) > 100
        assert float(track.provenance["hand_fit"].split()[1]) < 5.0  # mm
        surface = track.surface(len(track) // 2)[0]
        assert np.all((surface[:, 2] > 0.1) & (surface[:, 2] < 3.0))
