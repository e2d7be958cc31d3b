"""The HOT3D reader, on a synthetic recording, on broken files, and on HOT3D's sample files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from getagrip.batch.import_dataset import import_clips
from getagrip.cli import main
from getagrip.clip import FINGERS, Clip, read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.metrics.evaluate import evaluate_result
from getagrip.readers.datasets import cutting
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.hot3d import hot3d_files
from getagrip.readers.datasets.hot3d.hot3d_clips import HOT3D_GRASP_OPTIONS, Hot3d, cut_into_holds
from getagrip.stable_grasps import grasp_lists
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import segment
from helpers.environment import DATA, needs
from helpers.hand_object_files import HOLD, HOT3D_FRAMES, HOT3D_NAME, STEP, write_hot3d


@pytest.fixture
def root(tmp_path):
    return write_hot3d(tmp_path)


def read(root, note=lambda _: None):
    """The clips of all holds."""
    return clips(Hot3d(root=root), note)


@pytest.mark.slow
def test_a_hold_becomes_a_clip(root):
    notes = []
    ((clip, masks),) = read(root, notes.append)
    assert clip.name == HOLD
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
    # In the world, the box is where the recording has it; times are the recording's, from its first frame.
    T_world_obj = clip.world.T_world_cam @ clip.truth.T_cam_obj
    np.testing.assert_allclose(T_world_obj[:, :3, 3], [[-0.162, 0.0, 0.6]] * 12, atol=1e-12)
    np.testing.assert_array_equal(clip.world.up, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(clip.times, 1e-9 * STEP * np.arange(2, 14))
    # Object and hand do not overlap here, so the mask is the whole object.
    box = se3.transform(clip.truth.T_cam_obj[3], clip.mesh.vertices)
    seen = depth_and_face(box, clip.mesh.faces, clip.K[3], clip.size)[1] >= 0
    assert np.count_nonzero(seen) > 1000
    np.testing.assert_array_equal(masks.object[3] | masks.ignore[3], seen | masks.ignore[3])
    assert not np.any(masks.object & masks.ignore)
    posed = se3.transform(clip.truth.T_cam_hand[3], clip.truth.hand_vertices[3])
    drawn = depth_and_face(posed, clip.hand.faces, clip.K[3], clip.size)[1] >= 0
    assert masks.hand[3].any()
    assert not (masks.hand[3] & ~(masks.ignore[3] & drawn)).any()
    assert masks.object.shape == masks.ignore.shape == (12, 640, 640)
    assert clip.provenance["bop"] == {"dataset": "hot3d", "split": "test-quest3", "camera": "gray1"}
    json.dumps(clip.provenance)


@pytest.mark.slow
def test_files_may_lie_apart(root):
    apart = root / "hands" / HOT3D_NAME
    apart.mkdir(parents=True)
    for path in root.glob(f"sequences/{HOT3D_NAME}/umetrack*"):
        path.rename(apart / path.name)
    ((clip, _),) = read(root)
    assert len(clip) == 12


@pytest.mark.slow
def test_short_touches_are_no_holds(root):
    path = root / "sequences" / HOT3D_NAME / "umetrack_hand_pose_trajectory.jsonl"
    path.write_text("\n".join(path.read_text().splitlines()[:10]))  # contact in 8 frames; no hand after them
    assert list(read(root)) == []


@pytest.mark.slow
def test_the_other_recordings_are_read_before_an_error_is_raised(root):
    broken = root / "sequences" / "P0000_bad"
    broken.mkdir()
    (broken / "dynamic_objects.csv").write_text("object_uid\n")
    found = read(root)
    assert next(found)[0].name == HOLD
    with pytest.raises(InputError, match="P0000_bad"):
        list(found)


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
    path = root / "sequences" / HOT3D_NAME / name
    path.write_text(new if old is None else path.read_text().replace(old, new))
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        list(read(root))


def test_recordings_of_absurd_lengths_are_refused(root, monkeypatch):
    monkeypatch.setattr(hot3d_files, "MAX_SEQUENCE_FRAMES", HOT3D_FRAMES - 1)
    with pytest.raises(InputError, match=r"headset_trajectory\.csv must be 2 to 15.*got 16 frames"):
        list(read(root))
    monkeypatch.setattr(hot3d_files, "MAX_HOT3D_FILE_BYTES", 1000)
    with pytest.raises(InputError, match=r"must be at most 1000.*bytes"):
        list(read(root))


@pytest.mark.parametrize("name", ["train_aria/clip-000001.tar", "clip-000001/000000.objects.json"])
def test_hot3d_clips_are_named(tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir()
    path.touch()
    for folder in (tmp_path, *([path] if path.suffix == ".tar" else [])):
        with pytest.raises(InputError, match=r"HOT3D-Clips \(clip-\*\.tar\), another layout"):
            hot3d_files.find_hot3d_recordings(folder)


def test_missing_files_are_named(root):
    (root / "sequences" / HOT3D_NAME / "camera_models.json").unlink()
    with pytest.raises(InputError, match=r"camera_models\.json"):
        list(read(root))
    (root / "assets" / "instance.json").unlink()
    with pytest.raises(InputError, match=r"instance\.json"):
        list(read(root))
    with pytest.raises(InputError, match="no dynamic_objects"):
        list(read(root / "assets"))
    with pytest.raises(InputError, match="no such folder"):
        list(read(root / "nowhere"))


@pytest.mark.parametrize("name", ["../escape", "a/b", "", 3])
def test_object_names_that_could_be_paths_are_refused(root, name):
    (root / "assets" / "instance.json").write_text(json.dumps({"111": {"instance_name": name}}))
    with pytest.raises(InputError, match=r"instance\.json: 111"):
        list(read(root))


@pytest.mark.slow
def test_an_import_goes_on_where_it_stopped(root, tmp_path, run):
    call = ("import", "hot3d", root, "--out", tmp_path / "out")
    status, printed, _ = run(*call)
    assert (status, printed.splitlines()[-1]) == (0, "1 clip, 0 already there, 0 of 1 sequences failed")
    made = tmp_path / "out" / HOLD
    stamp = (made / "hand.npz").stat().st_mtime_ns
    broken = root / "sequences" / "P0000_bad"
    broken.mkdir()
    (broken / "dynamic_objects.csv").write_text("object_uid\n")
    status, printed, err = run(*call)
    assert (status, printed.splitlines()[-1]) == (1, "0 clips, 1 already there, 1 of 2 sequences failed")
    assert "P0000_bad" in err
    assert (made / "hand.npz").stat().st_mtime_ns == stamp
    assert import_clips(Hot3d(root=root), tmp_path / "some", debug=False, only={HOLD}) == 0  # no other is read
    assert json.loads((made / "clip.json").read_text())["provenance"]["subject"] == "P0000"


@pytest.mark.slow
def test_whole_recordings_show_what_is_outside_of_the_holds(root, tmp_path, run):
    assert run("import", "hot3d", root, "--out", tmp_path / "out", "--whole")[0] == 0
    assert [folder.name for folder in (tmp_path / "out").glob("*/")] == [HOLD]
    assert not (tmp_path / "out" / HOLD / "masks").exists()
    (source,) = Hot3d(root=root).sources()
    (piece,) = cut_into_holds(source.read(print), print, HOT3D_GRASP_OPTIONS.cut(print))
    clip, _ = cutting.clip_of_piece(piece, HOT3D_GRASP_OPTIONS.shortest, print)
    assert (clip.name, clip.frames) == (HOLD, frames(tmp_path / "out" / HOLD))
    assert clip.frames == tuple(f"{n:06d}" for n in range(HOT3D_FRAMES))
    assert segment(clip, Definition(contact=0.005, points="area", shortest=5))[1] == [(2, 13)]
    other = replace(piece.track.take(np.array([1, 4])), side="left")
    both, _ = cutting.clip_of_piece(replace(piece, other=other), HOT3D_GRASP_OPTIONS.shortest, print)
    assert np.flatnonzero(both.other_hand.known).tolist() == [1, 4]
    np.testing.assert_array_equal(both.other_hand.track.T_cam_hand[:2], clip.hand.T_cam_hand[[1, 1]])


@pytest.mark.slow
def test_an_interaction_becomes_a_timeline(root, tmp_path):
    """The hand has the box in frames 2 to 13, before and after which the box is 2 cm aside."""
    ((clip, masks),) = clips(Hot3d(root=root, timelines=True))
    assert clip.name == f"{HOLD}--000000-000015"
    assert [(s.state, s.first, s.last, s.side) for s in clip.segments] == [
        ("free", 0, 1, None), ("grasp", 2, 13, "right"), ("free", 14, 15, None),
    ]  # fmt: skip
    assert masks.object.any()
    listed = replace(HOT3D_GRASP_OPTIONS, listed=timelines(tmp_path / "hit.json"))
    ((clip, _),) = clips(Hot3d(root=root, timelines=True, grasps=listed))
    assert [(s.state, s.first, s.last, s.side) for s in clip.segments] == [
        ("grasp", 0, 2, "left"), ("grasp", 3, 6, "right"), ("grasp", 7, 7, "left"), ("grasp", 8, 8, "right"),
        ("grasp", 9, 9, "right"), ("grasp", 10, 15, "right"),
    ]  # fmt: skip
    with pytest.raises(UsageError, match="--timelines cannot be used with --whole"):
        list(clips(Hot3d(root=root, timelines=True, whole=True)))


def frames(clip):
    """The frames that a clip's folder names."""
    return tuple(json.loads((clip / "clip.json").read_text())["frames"])


def timelines(path, **changes):
    """A list in which the right hand has the box from frame 3 to 6, then from 8 to 40; and what is not to be read."""
    segments = [(3, 6, "right", "inhand"), (6, 8, None, "scene_dynamic"), (8, 40, "right", "inhand")]
    segments += [(9, 9, "right", "inhand"), (50, 2, "right", "inhand"), (0, 15, "left", "inhand")]
    entry = {
        "timeline_name": f"{HOT3D_NAME}_red_box_00000_00016", "seq_name": HOT3D_NAME, "cat": "red_box",
        "total_start": 0, "total_end": HOT3D_FRAMES,
        "segments": [dict(zip(("st", "ed", "side", "ref"), s, strict=True)) for s in segments],
    }  # fmt: skip
    path.write_text(json.dumps([entry | changes]))
    return path


@pytest.mark.slow
def test_grasps_of_a_list(root, tmp_path, run):
    listed = timelines(tmp_path / "hit.json")
    status, _, err = run("import", "hot3d", root, "--out", tmp_path / "out", "--list", listed)
    assert status == 0
    assert "hit.json: 1 grasp and 0 other segments end before they start: skipped" in err
    assert f"{HOLD}--00009-00009: hand and object are known in 1 of its frames: skipped" in err
    found = {path.parent.name: frames(path.parent) for path in (tmp_path / "out").glob("*/clip.json")}
    assert found == {
        f"{HOLD}--00003-00006": tuple(f"{n:06d}" for n in range(3, 7)),  # both ends included
        f"{HOLD}--00008-00040": tuple(f"{n:06d}" for n in range(8, HOT3D_FRAMES)),
    }


@pytest.mark.slow
def test_a_list_that_counts_other_frames_is_refused_unless_its_first_number_is_given(root, tmp_path, run):
    listed = timelines(tmp_path / "hit.json", total_end=HOT3D_FRAMES + 4)
    call = ("import", "hot3d", root, "--out", tmp_path / "out", "--list", listed)
    status, _, err = run(*call)
    assert status == 1
    assert "must be 20, as the list counts them: say with --first-frame" in err
    assert run(*call, "--first-frame", 4)[0] == 0
    found = {path.parent.name: frames(path.parent) for path in (tmp_path / "out").glob("*/clip.json")}
    assert found[f"{HOLD}--00003-00006"] == ("000000", "000001", "000002")
    assert found[f"{HOLD}--00008-00040"][0] == "000004"


@pytest.mark.slow
def test_wrong_calls_with_lists(root, tmp_path, run):
    listed = timelines(tmp_path / "hit.json", seq_name="P0001_other")
    call = ("import", "hot3d", root, "--out", tmp_path / "out")
    assert run(*call, "--list", listed)[0] == 1
    assert run(*call, "--list", listed, "--whole")[0] == 2
    assert run(*call, "--first-frame", 3)[0] == 2
    assert run("import", "ho3d", root, "--out", tmp_path / "out", "--first-frame", 3)[0] == 2


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seq_name": "../x"}, r"\[0\].seq_name"),
        ({"seq_name": None}, r"\[0\].seq_name"),
        ({"cat": 3}, r"\[0\].cat"),
        ({"total_end": "16"}, r"\[0\].total_end"),
        ({"total_end": -1}, r"\[0\].total_end"),
        ({"segments": None}, r"\[0\].segments"),
        ({"segments": [3]}, r"\[0\].segments"),
        ({"segments": [{"ed": 3}]}, r"segments\[0\].st"),
        ({"segments": [{"st": 1.5, "ed": 3}]}, r"segments\[0\].st"),
        ({"segments": [{"st": 1, "ed": 10**30}]}, r"segments\[0\].ed"),
        ({"segments": [{"st": 1, "ed": 3, "ref": "thrown"}]}, r"segments\[0\].ref"),
        ({"segments": [{"st": 1, "ed": 3, "ref": []}]}, r"segments\[0\].ref"),
        ({"segments": [{"st": 1, "ed": 3, "ref": "inhand", "side": None}]}, r"segments\[0\].side"),
    ],
)
def test_broken_lists_are_named(tmp_path, changes, named):
    with pytest.raises(InputError, match=named):
        grasp_lists.read_listed_grasps(timelines(tmp_path / "hit.json", **changes))


def test_only_what_is_in_a_hand_is_a_grasp(tmp_path):
    kinds = [("inhand", "left"), ("scene_dynamic", "left"), ("scene_static", None)]
    segments = [{"st": 10 * n, "ed": 10 * n + 5, "ref": ref, "side": side} for n, (ref, side) in enumerate(kinds)]
    assert [
        one.first for one in grasp_lists.read_listed_grasps(timelines(tmp_path / "hit.json", segments=segments)).grasps
    ] == [0]


@pytest.mark.parametrize("content", [b"", b"{}", b"[" * 100_000, b"\xff", b"[3]", b"null"])
def test_what_is_no_list_is_refused(tmp_path, content):
    (tmp_path / "hit.json").write_bytes(content)
    with pytest.raises(InputError, match=r"hit\.json"):
        grasp_lists.read_listed_grasps(tmp_path / "hit.json")


HOT3D = DATA / "hot3d"
POT = "P0003--c701bd11--coffee_pot--left"
HOLDS = {POT: 34, "P0003--c701bd11--mug_white--right": 34, "P0002--273c2819--mouse--right": 15}
"""Frames of a pot lifted to pour, of a mug held still on the table, of a mouse moved about."""

pytestmark = [needs(HOT3D), pytest.mark.slow, pytest.mark.long]


def three_fingertips_and_more_are_at_the_object(clip: Clip) -> None:
    assert read_masks(clip.take(np.arange(0, len(clip), 5))).object.any(axis=(1, 2)).all()
    assert clip.truth is not None
    assert clip.truth.scale == 1.0
    hand = se3.transform(clip.truth.T_cam_hand, clip.truth.hand_vertices)
    corners = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices[clip.mesh.faces].mean(axis=1))
    for n in (0, len(clip) - 1):
        distance, _ = cKDTree(corners[n]).query(hand[n])
        pads = [distance[clip.hand.regions[finger]].min() for finger in FINGERS]
        assert sorted(pads)[2] < 0.008


def test_clips_and_results(tmp_path: Path) -> None:
    """In one test, since reading the samples takes longer than all that is asserted of them."""
    clips = tmp_path / "clips"
    assert main(["import", "hot3d", str(HOT3D), "--out", str(clips)]) == 0
    found = {path.name: read_clip(path) for path in clips.iterdir() if path.is_dir()}
    assert {name: len(clip) for name, clip in found.items()} == HOLDS
    for clip in found.values():
        three_fingertips_and_more_are_at_the_object(clip)
    for points in ("vertices", "area"):  # the one proper lifted grasp; contact is reliable at 5 mm
        assert segment(found[POT], Definition(contact=0.005, points=points))[1] == [(0, 33)]
    quick = ("--workers", "1", "--frames", "12", "--inits", "25", "--sampled-only")
    assert main(["reconstruct", str(clips / POT), "--out", str(tmp_path / "out"), *quick]) == 0
    metrics = evaluate_result(tmp_path / "out" / POT, clips).metrics
    assert metrics["add_success"] == 1.0, metrics["add_mm"]
    assert metrics["iou_full"] > 0.95
