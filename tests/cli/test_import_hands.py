"""``import hands``: hands that a clip gets after its images, in some of its frames or in all, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.cli import main
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.clip.read_arrays import read_hand
from getagrip.clip.write import write_hand
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from getagrip.io import arrays, files
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.folders import FullDisk, contents
from helpers.results import AHEAD, everything, new


@pytest.mark.slow
def test_in_steps(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without masks and hands the clip has its images; each is added later, frames without a hand are left out."""
    mesh = ["--mesh", str(made / "unit.obj"), "--diameter-mm", "130", "--guess-focal"]
    assert main(new(made, "--interval", "3", "8", "--side", "right", *mesh)) == 3
    printed = capsys.readouterr().err
    for word in ("missing: masks", "missing: hands", "guess", "import hands"):
        assert word in printed
    folder = made / "cup"
    assert len(list((folder / "frames").iterdir())) == 6
    masks = ["--object", "1", "--ignore", "2", "--clip", str(folder)]
    assert main(["import", "masks", str(made / "masks"), *masks]) == 0
    hand = generic.load("right").with_shape().with_pose()
    joints = hand.joints + AHEAD
    arrays.write(made / "joints.npz", {"joints": np.tile(joints, (5, 1, 1)), "frames": np.array([3, 4, 6, 7, 8])})
    hands = ["import", "hands", str(made / "joints.npz"), "--from", "joints", "--order", "openpose"]
    assert main([*hands, "--clip", str(folder)]) == 0
    printed = capsys.readouterr().err
    assert "no hand in 1 of 6 frames" in printed
    clip = read_clip(folder)
    assert clip.frames == ("000003", "000004", "000006", "000007", "000008")
    assert clip.times is not None
    np.testing.assert_allclose(clip.times, np.array([2, 3, 5, 6, 7]) / clip.fps)  # since the video's first frame
    assert read_masks(clip).observed.all()
    assert clip.hand.joints is not None
    seen = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    assert np.abs(seen - joints).max() < 0.01
    assert "guess" in str(clip.provenance["camera"])
    assert clip.provenance["masks"].startswith("from masks")
    assert "000005" in clip.provenance["frames_without_hand"]
    assert main([*hands, "--clip", str(folder)]) == 2
    arrays.write(made / "joints.npz", {"joints": np.tile(joints, (2, 1, 1)), "frames": np.array([5, 7])})
    assert main([*hands, "--clip", str(folder), "--overwrite", "--hold-ends"]) == 0
    clip = read_clip(folder)
    assert clip.frames == ("000003", "000004", "000005", "000007", "000008")
    assert "a guess in the frames 000003 to 000004 and 000008 to 000008" in str(clip.provenance["hands_held"])
    assert clip.provenance["frames_without_hand"].endswith(": 000006")
    arrays.write(made / "joints.npz", {"joints": np.tile(joints, (6, 1, 1))})
    assert main([*hands, "--clip", str(folder), "--overwrite"]) == 0
    clip = read_clip(folder)
    assert clip.frames == tuple(f"{n:06d}" for n in range(3, 9))
    assert not {"frames_without_hand", "hands_held"} & set(clip.provenance)
    assert read_masks(clip).observed.all()
    two = {"joints": np.tile([-1.0, 1.0, 1.0] * hand.joints + AHEAD, (2, 1, 1)), "frames": np.array([4, 7])}
    arrays.write(made / "joints.npz", two)
    assert main([*hands, "--clip", str(folder), "--other-hand"]) == 0
    other = read_clip(folder).other_hand
    assert other is not None
    np.testing.assert_array_equal(np.flatnonzero(other.known), [1, 4])
    assert main([*hands, "--clip", str(folder), "--other-hand"]) == 2
    assert main([*hands, "--clip", str(folder), "--other-hand", "--hold-ends"]) == 2


@pytest.mark.slow
def test_frames_without_a_hand_stay_and_get_one_later(made: Path, run: Run) -> None:
    numbers = np.array([3, 4, 6, 7, 8, 9])
    hand = generic.load("right").with_shape().with_pose()
    track = hand_track(hand, np.tile(se3.rigid(None, AHEAD), (6, 1, 1)))
    write_hand(track, made / "some.npz", {"frames": numbers})
    status, out, err = run(*new(made, *everything(made), "--hands", str(made / "some.npz")))
    assert status == 0
    assert "6 frames" in out
    assert "no hand in 1 of 6 frames" in err
    clip = read_clip(made / "cup")
    assert clip.frames == ("000003", "000004", "000006", "000007", "000008")
    assert clip.provenance["frames_without_hand"].endswith(": 000005")
    assert clip.times is not None
    np.testing.assert_allclose(clip.times, np.array([2, 3, 5, 6, 7]) / clip.fps)
    assert read_masks(clip).observed.all()
    assert (made / "cup" / "frames" / "000005.jpg").is_file()
    joints = np.tile(hand.joints + AHEAD, (6, 1, 1))
    arrays.write(made / "joints.npz", {"joints": joints})
    hands = ["import", "hands", made / "joints.npz", "--from", "joints", "--order", "openpose"]
    assert run(*hands, "--clip", made / "cup", "--overwrite")[0] == 0
    clip = read_clip(made / "cup")
    assert clip.frames == tuple(f"{n:06d}" for n in range(3, 9))
    assert "frames_without_hand" not in clip.provenance
    assert read_masks(clip).observed.all()


@pytest.mark.slow
def test_hands_and_what_clip_json_says_of_them_come_together_or_not_at_all(
    made: Path, run: Run, full_disk: FullDisk
) -> None:
    """Here the disk has room for the hands only."""
    run(*new(made, *everything(made)))
    path = made / "cup" / "clip.json"
    fields = json.loads(path.read_text())
    files.write_json(path, fields | {"provenance": {"note": 500_000 * "x"}})
    hand = generic.load("right").with_shape().with_pose()
    arrays.write(made / "joints.npz", {"joints": np.tile(hand.joints + AHEAD, (4, 1, 1)), "frames": np.arange(3, 7)})
    before = contents(made)
    command = ["import", "hands", made / "joints.npz", "--from", "joints", "--order", "openpose", "--clip", path.parent]
    with full_disk(400_000):
        status, _, err = run(*command)
    assert status == 1
    assert f"'{path}'" in err
    assert contents(made) == before
    assert run(*command)[0] == 0
    assert read_clip(path.parent).frames == ("000003", "000004", "000005", "000006")


@pytest.mark.slow
def test_a_hand_file_brings_its_frames_and_its_camera(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand = generic.load("left").with_shape().with_pose()
    joints = np.tile(hand.joints + AHEAD, (5, 1, 1))
    arrays.write(made / "joints.npz", {"joints": joints, "frames": np.array([2, 3, 4, 5, 7])})
    out = ["--out", str(made / "h.npz"), "--side", "left", "--frames", "1", "9", "--size", "64", "48", "--guess-focal"]
    hands = ["import", "hands", str(made / "joints.npz"), "--from", "joints", "--order", "openpose"]
    assert main([*hands, *out]) == 0
    assert "warning: camera: a guess" in capsys.readouterr().err
    mesh = ["--mesh", str(made / "unit.obj"), "--size-mm", "120", "--masks", str(made / "masks"), "--object", "1"]
    wrong = new(made, "--interval", "3", "7", "--side", "right", *mesh, "--hands", str(made / "h.npz"))
    assert main(wrong) == 1
    assert "a left hand" in capsys.readouterr().err
    right = new(made, "--interval", "3", "7", "--side", "left", *mesh, "--hands", str(made / "h.npz"))
    assert main(right) == 0
    clip = read_clip(made / "cup")
    assert clip.frames == ("000003", "000004", "000005", "000007")
    assert clip.K[0, 0, 0] == 64.0
    assert "guess" in str(clip.provenance["camera"])


@pytest.mark.slow
def test_joints_that_do_not_fit_the_clip_are_refused_in_plain_words(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["--interval", "3", "8", "--side", "right", "--focal", "60", "--mesh", "mug"]
    assert main(new(made, *base)) == 3
    joints = np.tile(generic.load("right").with_shape().with_pose().joints + AHEAD, (6, 1, 1))
    for values, first, words in [
        (joints, 300, "must be hands in the clip's, 000003 to 000008"),
        (joints - 2.0 * AHEAD, 3, "m behind the camera"),
        (1000.0 * joints, 3, "is the unit the metre"),
    ]:
        arrays.write(made / "j.npz", {"joints": values, "frames": np.arange(first, first + 6)})
        command = ["import", "hands", str(made / "j.npz"), "--from", "joints", "--order", "openpose"]
        assert main([*command, "--clip", str(made / "cup")]) == 1
        err = capsys.readouterr().err
        assert words in err
        assert err.splitlines()[-1].count(" must be ") == 1


@pytest.mark.slow
def test_hands_need_a_place_to_go(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_clip(*small_clip(), made / "small")
    path = made / "hands.npz"
    arrays.write(path, {"joints": np.zeros((2, 21, 3))})
    base = ["import", "hands", str(path), "--from", "joints", "--order", "openpose"]
    for more, words in [
        ([], "missing --clip or --out"),
        (["--clip", str(folder)], "--overwrite"),
        (["--clip", str(folder), "--side", "left"], "--side"),
        (["--out", str(made / "x.npz"), "--side", "left"], "--frames"),
        (["--clip", str(folder), "--overwrite"], "truth"),
    ]:
        if words == "truth":
            assert main([*base, *more]) == 1  # joints that are no hand's
        else:
            assert main([*base, *more]) == 2
            assert words in capsys.readouterr().err


@pytest.mark.slow
def test_hands_that_are_flagged_are_written_with_status_3(made: Path, run: Run) -> None:
    """They fit no hand, or most frames have none."""
    run(*new(made, "--interval", "3", "8", "--side", "right", "--focal", "60", "--mesh", "mug"))
    joints = np.tile(generic.load("right").with_shape().with_pose().joints + AHEAD, (6, 1, 1))
    tips = joints.copy()
    tips[:, [4, 20]] = tips[:, [20, 4]]
    command = ["import", "hands", made / "j.npz", "--from", "joints", "--order", "auto", "--clip", made / "cup"]
    for values, numbers, words in [
        (tips, range(3, 9), "mm off every pose of a hand"),
        (joints[:2], [3, 4], "only 2 of 6 frames have a hand"),
    ]:
        arrays.write(made / "j.npz", {"joints": values, "frames": np.array(numbers)})
        status, _, err = run(*command, "--overwrite")
        assert status == 3
        assert words in err
        assert (made / "cup" / "hand.npz").is_file()
    assert run(*command, "--overwrite", "--hold-ends")[0] == 0


@pytest.mark.slow
def test_of_two_hands_in_a_frame_the_one_in_the_clips_mask_is_taken(made: Path, run: Run) -> None:
    run(*new(made, "--interval", "3", "8", "--side", "right", "--focal", "60", "--mesh", "mug"))
    hand = generic.load("right").with_shape().with_pose().joints
    places = [AHEAD, AHEAD + np.array([0.25, 0.0, 0.0])]
    joints = np.concatenate([np.tile(hand + place, (6, 1, 1)) for place in places])
    arrays.write(made / "j.npz", {"joints": joints, "frames": np.tile(np.arange(3, 9), 2)})
    command = ["import", "hands", made / "j.npz", "--from", "joints", "--order", "openpose", "--clip", made / "cup"]
    (made / "cup" / "masks" / "hand").mkdir(parents=True)
    for row, place in enumerate(places):
        for name in range(3, 9):
            image = np.zeros((48, 64), np.uint8)
            u = 60 * (hand + place)[:, 0] / (hand + place)[:, 2] + 32
            image[:, max(0, int(u.min())) : int(u.max()) + 1] = 255
            cv2.imwrite(str(made / "cup" / "masks" / "hand" / f"{name:06d}.png"), image)
        status, _, err = run(*command, "--overwrite")
        assert status == 0
        assert "by the hand's mask in 6" in err, row
        track = read_hand(made / "cup" / "hand.npz", 6)
        seen = se3.transform(track.T_cam_hand, track.vertices).mean(axis=(0, 1))
        assert np.argmin([abs(seen[0] - (hand + p).mean(axis=0)[0]) for p in places]) == row
