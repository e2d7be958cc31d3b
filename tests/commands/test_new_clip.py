"""``clip new`` and ``import hands``: from a video, masks, hands and a mesh to a clip that everything else can use."""

from __future__ import annotations

import json
import re
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.annotate.video import Video
from getagrip.cli import main
from getagrip.clip import Segment, read_clip, read_masks, write_clip
from getagrip.clip.video import video_frames, video_info
from getagrip.clip.writing import write_hand
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh, write_mesh
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from getagrip.io import arrays, files
from helpers.clips import box, small_clip
from helpers.command_line import Run
from helpers.folders import FullDisk, contents

SIZE = (64, 48)
K = ("60", "60", "32", "24")
FRAMES = 12
AHEAD = np.array([0.0, 0.0, 0.4])


def write_video(path: Path, frames: int = FRAMES) -> Path:
    """A video each of whose frames has as many white bars as its number, from 1."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for n in range(1, frames + 1):
            image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
            for bar in range(n):
                image[:, 4 * bar + 1 : 4 * bar + 4] = 255
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def bars(image: ndarray) -> int:
    """How many bars an image has: the number of its frame."""
    bright = image.mean(axis=(0, 2))[2::4] > 128
    return int(np.count_nonzero(bright))


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A folder with a video, masks of it, a mesh in a generator's unit, and hands in some of its frames."""
    write_video(tmp_path / "video.mp4")
    (tmp_path / "masks").mkdir()
    for n in range(1, FRAMES + 1):
        mask = np.zeros(SIZE[::-1], np.uint8)
        mask[20:30, 10 + n : 30 + n] = 1
        mask[30:40, 10:30] = 2
        cv2.imwrite(str(tmp_path / "masks" / f"{n:05d}.png"), mask)
    write_mesh(box(1.0, 0.6, 0.5), tmp_path / "unit.obj")
    hand = generic.load("right").with_shape().with_pose()
    T = np.tile(se3.rigid(None, AHEAD), (6, 1, 1))
    write_hand(hand_track(hand, T), tmp_path / "six.npz")
    return tmp_path


def new(made: Path, *more: str) -> list[str]:
    return ["clip", "new", str(made / "video.mp4"), "--out", str(made / "cup"), *more]


def everything(made: Path) -> list[str]:
    return [
        "--interval", "3", "8", "--side", "right", "--mesh", str(made / "unit.obj"), "--size-mm", "120",
        "--masks", str(made / "masks"), "--object", "1", "--ignore", "2", "--K", *K,
    ]  # fmt: skip


def test_frames_of_a_video_are_counted_from_1(made: Path) -> None:
    info = video_info(made / "video.mp4")
    assert (info.size, info.fps) == (SIZE, 25.0)
    assert [bars(image) for image in video_frames(made / "video.mp4", 4, 9)] == [4, 5, 6, 7, 8, 9]
    with pytest.raises(InputError, match="12 frames"):
        list(video_frames(made / "video.mp4", 4, 13))


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    """Playlists and concatenations, which name other files, too."""
    for name, content in [("a.mp4", b"no"), ("b.mp4", b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n"), ("c.mp4", b"ffconcat")]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            video_info(tmp_path / name)
    with pytest.raises(InputError, match="a folder, expected a video; ffmpeg"):
        video_info(tmp_path)


def test_everything_at_once(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files.write_json(made / "s.json", {"video": {"segments": [{"state": "static", "first": "1", "last": "5"}]}})
    segments = ["--segments", str(made / "s.json"), "--still-camera"]
    assert main(new(made, *everything(made), "--hands", str(made / "six.npz"), *segments)) == 0
    clip = read_clip(made / "cup")
    assert clip.segments == (Segment("static", 0, 2),)
    assert "as the user states" in clip.provenance["camera_pose"]
    masks = read_masks(clip)
    assert clip.frames == tuple(f"{n:06d}" for n in range(3, 9))
    assert (clip.fps, clip.size, clip.scale, clip.side) == (25.0, SIZE, "known", "right")
    np.testing.assert_allclose(np.ptp(clip.mesh.vertices, axis=0).max(), 0.120)
    assert "rescaled" in clip.provenance["scale"]
    np.testing.assert_array_equal(clip.K[0], [[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    for n, name in enumerate(clip.frames):
        image = cv2.imread(str(made / "cup" / "frames" / f"{name}.jpg"))
        assert bars(image) == int(name)
        assert masks.object[n].sum() == 200
        assert masks.object[n, 25, 10 + int(name)]
        assert not masks.object[n, 25, 9 + int(name)]
        assert masks.ignore[n].sum() == 200
    assert "guess" not in capsys.readouterr().err


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


def test_images_that_the_disk_has_no_room_for_leave_no_clip(made: Path, run: Run, full_disk: FullDisk) -> None:
    before = contents(made)
    with full_disk(880):
        status, _, err = run(*new(made, *everything(made)))
    assert status == 1
    images = re.escape(str(made / "cup" / "frames"))
    assert re.fullmatch(rf"getagrip: \[Errno 27\] File too large: '{images}/\d+\.jpg'\n", err)
    assert contents(made) == before


def test_what_is_missing_is_reported(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(new(made)) == 2
    printed = capsys.readouterr().err
    for word in ("interval", "side", "mesh", "camera"):
        assert f"missing: {word}" in printed
    assert not (made / "cup").exists()


@pytest.mark.slow
def test_in_steps(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without masks and hands the clip has its images; each is added later, frames without a hand are left out."""
    mesh = ["--mesh", str(made / "unit.obj"), "--diameter-mm", "130", "--guess-focal"]
    assert main(new(made, "--interval", "3", "8", "--side", "right", *mesh)) == 1
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
    assert "guess" in clip.provenance["camera"]
    assert clip.provenance["masks"].startswith("from masks")
    assert "000005" in clip.provenance["frames_without_hand"]
    assert main([*hands, "--clip", str(folder)]) == 2
    arrays.write(made / "joints.npz", {"joints": np.tile(joints, (2, 1, 1)), "frames": np.array([5, 7])})
    assert main([*hands, "--clip", str(folder), "--overwrite", "--hold-ends"]) == 0
    clip = read_clip(folder)
    assert clip.frames == ("000003", "000004", "000005", "000007", "000008")
    assert "a guess in the frames 000003 to 000004 and 000008 to 000008" in clip.provenance["hands_held"]
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


def test_only_a_clip_is_overwritten(made: Path, run: Run) -> None:
    command = new(made, *everything(made))
    assert run(*command)[0] == 1  # without hands
    assert run(*command)[0] == 2
    assert run(*command, "--overwrite")[0] == 1
    (made / "cup" / "clip.json").rename(made / "cup" / "mine.json")
    before = contents(made)
    status, _, err = run(*command, "--overwrite")
    assert status == 2
    assert err == f"getagrip: {made / 'cup'}: exists already without 'clip.json' in it; it is not overwritten\n"
    assert contents(made) == before


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
    assert "guess" in clip.provenance["camera"]


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (["--interval", "3", "30"], 1, "no mask of 18 of 28 frames"),
        (["--interval", "8", "3"], 2, "--interval"),
        (["--object", "7"], 1, "without a pixel of the object; there are 0, 1, 2"),
        (["--masks", "nowhere"], 1, "no such file or folder"),
        (["--K", "60", "60", "32000", "24"], 2, "--K"),
        (["--focal", "60"], 2, "--K, --focal"),
        (["--size-mm", "-1"], 2, "--size-mm"),
        (["--diameter-mm", "5"], 2, "both"),
        (["--mesh", "nowhere.obj"], 1, "nowhere.obj"),
        (["--mesh", "plates"], 1, "this package's shapes: bottle, bowl"),
    ],
)
@pytest.mark.slow
def test_what_does_not_fit_is_named(
    made: Path, capsys: pytest.CaptureFixture[str], change: list[str], status: int, words: str
) -> None:

    base = everything(made)
    if change[0] in base:
        at = base.index(change[0])
        base[at : at + len(change)] = change
        change = []
    hands = [] if "30" in base else ["--hands", str(made / "six.npz")]
    assert main(new(made, *base, *change, *hands)) == status
    assert words in capsys.readouterr().err
    assert [path.name for path in made.iterdir() if path.name.startswith((".", "cup"))] == []


def test_generated_meshes_may_have_slivers(made: Path) -> None:
    with (made / "unit.obj").open("a") as file:
        file.write("\nf 1 1 2\nf 3 3 3\n")
    mesh = ["--mesh", str(made / "unit.obj"), "--size-mm", "120", "--interval", "1", "3", "--side", "left"]
    assert main(new(made, *mesh, "--focal", "60")) == 1
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert "2 faces without area" in fields["provenance"]["mesh"]


def test_a_kind_of_object_is_a_shape_of_the_package(
    made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its size is to be found, or stated; a file of that name comes first."""
    monkeypatch.chdir(made)
    base = ["--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "plate", "--overwrite"]
    assert main(new(made, *base)) == 1
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert (fields["category"], fields["scale"]) == ("plate", "free")
    assert "this package's own plate: a guess" in fields["provenance"]["mesh"]
    assert "warning: mesh: " in capsys.readouterr().err
    assert main(new(made, *base, "--category", "saucer", "--size-mm", "150")) == 1
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert (fields["category"], fields["scale"]) == ("saucer", "known")
    np.testing.assert_allclose(np.ptp(read_mesh(made / "cup" / "object.obj").vertices, axis=0).max(), 0.15)
    assert main(new(made, *base, "--known-scale")) == 2
    assert "--known-scale" in capsys.readouterr().err
    (made / "plate").write_text("no mesh")
    assert main(new(made, *base)) == 1
    assert "the suffix ''" in capsys.readouterr().err


def test_the_way_without_an_estimator_is_shown(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(new(made, "--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "mug")) == 1
    assert capsys.readouterr().err.count(f"getagrip annotate {made / 'video.mp4'}") == 2


def test_a_wrong_label_is_reported_before_there_are_hands(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    masks = ["--masks", str(made / "masks"), "--object", "7"]
    assert main(new(made, "--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "mug", *masks)) == 1
    assert "there are 0, 1, 2" in capsys.readouterr().err
    assert not (made / "cup").exists()


@pytest.mark.slow
def test_joints_that_do_not_fit_the_clip_are_refused_in_plain_words(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["--interval", "3", "8", "--side", "right", "--focal", "60", "--mesh", "mug"]
    assert main(new(made, *base)) == 1
    joints = np.tile(generic.load("right").with_shape().with_pose().joints + AHEAD, (6, 1, 1))
    for values, first, words in [
        (joints, 300, "got hands in other frames (300, ...), expected hands in the clip's, 000003 to 000008"),
        (joints - 2.0 * AHEAD, 3, "m behind the camera"),
        (1000.0 * joints, 3, "joints: got hands with "),
    ]:
        arrays.write(made / "j.npz", {"joints": values, "frames": np.arange(first, first + 6)})
        command = ["import", "hands", str(made / "j.npz"), "--from", "joints", "--order", "openpose"]
        assert main([*command, "--clip", str(made / "cup")]) == 1
        err = capsys.readouterr().err
        assert words in err
        assert err.splitlines()[-1].count(", expected ") == 1


def write_turned(path: Path, turned: Path) -> None:
    """The same video with a display matrix, as telephones write it: a quarter to the right."""
    content = bytearray(path.read_bytes())
    header = content.find(b"tkhd")
    at = header + 4 + 4 + (32 if content[header + 4] else 20) + 16
    content[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    turned.write_bytes(content)


def test_upright_videos_of_telephones_are_upright(made: Path) -> None:
    """They are stored lying; clip new and annotate turn them alike."""
    write_turned(made / "video.mp4", made / "turned.mp4")
    assert video_info(made / "turned.mp4").size == SIZE[::-1]
    (image,) = video_frames(made / "turned.mp4", 3, 3)
    np.testing.assert_array_equal(image, np.rot90(next(video_frames(made / "video.mp4", 3, 3)), -1))
    shown = Video(made / "turned.mp4")
    np.testing.assert_array_equal(shown.image(2), image)
    shown.close()


@pytest.mark.slow
def test_hands_need_a_place_to_go(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_clip(*small_clip(), made / "small")
    path = made / "hands.npz"
    arrays.write(path, {"joints": np.zeros((2, 21, 3))})
    base = ["import", "hands", str(path), "--from", "joints", "--order", "openpose"]
    for more, words in [
        ([], "neither"),
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


@pytest.mark.parametrize("option", ["--size-mm", "--diameter-mm"])
def test_sizes_are_refused_in_the_unit_in_which_they_are_given(made: Path, capsys: Any, option: str) -> None:
    mesh = ["--mesh", str(made / "unit.obj"), option, "0.25", "--interval", "1", "3", "--side", "left", "--K", *K]
    assert main(new(made, *mesh)) == 2
    assert f"{option}: got 0.25, expected 5 to 2000 millimetres" in capsys.readouterr().err
