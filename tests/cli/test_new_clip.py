"""``clip new``: a clip from a video, masks, hands and a mesh of any unit, in one step."""

from __future__ import annotations

import json
import re
import struct
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest

from getagrip.cli import main
from getagrip.cli.new_clip import MeshOptions, Unit, read_own_mesh
from getagrip.clip import Segment, read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry.mesh_files import read_mesh
from getagrip.io import arrays, files
from getagrip.io.images import write_image
from getagrip.readers.footage import VideoFootage
from getagrip.readers.video import video_frames, video_info
from helpers import labelled_scene
from helpers.environment import Run
from helpers.folders import FullDisk, contents
from helpers.results import SIZE, K, bars, everything, new


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
    with pytest.raises(InputError, match=r"must be a video.*a folder"):
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
    assert "rescaled" in str(clip.provenance["scale"])
    np.testing.assert_array_equal(clip.K[0], [[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    for n, name in enumerate(clip.frames):
        image = cv2.imread(str(made / "cup" / "frames" / f"{name}.jpg"))
        assert bars(image) == int(name)
        assert masks.object[n].sum() == 200
        assert masks.object[n, 25, 10 + int(name)]
        assert not masks.object[n, 25, 9 + int(name)]
        assert masks.ignore[n].sum() == 200
    assert "guess" not in capsys.readouterr().err


def test_images_that_the_disk_has_no_room_for_leave_no_clip(made: Path, run: Run, full_disk: FullDisk) -> None:
    before = contents(made)
    with full_disk(1000):
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


def test_only_a_clip_is_overwritten(made: Path, run: Run) -> None:
    command = new(made, *everything(made))
    assert run(*command)[0] == 3  # without hands
    assert run(*command)[0] == 2
    assert run(*command, "--overwrite")[0] == 3
    (made / "cup" / "clip.json").rename(made / "cup" / "mine.json")
    before = contents(made)
    status, _, err = run(*command, "--overwrite")
    assert status == 2
    assert err == f"getagrip: {made / 'cup'}: exists already without 'clip.json' in it; it is not overwritten\n"
    assert contents(made) == before


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (["--interval", "3", "30"], 1, "must be at least 30"),
        (["--interval", "8", "3"], 2, "--interval"),
        (["--mesh", "plte"], 1, "plte"),
        (["--object", "7"], 1, "without a pixel of the object; there are 0, 1, 2"),
        (["--masks", "nowhere"], 1, "no such file or folder"),
        (["--K", "60", "60", "32000", "24"], 2, "--K"),
        (["--focal", "60"], 2, "--K, --focal"),
        (["--size-mm", "-1"], 2, "--size-mm"),
        (["--diameter-mm", "5"], 2, "--size-mm cannot be used with --diameter-mm"),
        (["--mesh", "nowhere.obj"], 1, "nowhere.obj"),
        (["--mesh", "plates"], 1, "this package's shapes: ball, banana, book, bottle"),
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
    assert main(new(made, *mesh, "--focal", "60")) == 3
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert "2 faces without area" in fields["provenance"]["mesh"]["text"]


def test_a_handle_is_marked_in_the_coordinates_of_the_mesh(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "mug", "--overwrite"]
    mug = read_own_mesh(MeshOptions(Path("mug"))).mesh
    low, high = mug.vertices.min(axis=0), mug.vertices.max(axis=0)
    line = [0.5 * (low + high), 0.25 * low + 0.75 * high]
    size = str(2e3 * np.ptp(mug.vertices, axis=0).max())
    words = [",".join(map(str, point.tolist())) for point in line]
    assert main(new(made, *base, "--size-mm", size, "--handle", *words)) == 3
    fields = json.loads((made / "cup" / "clip.json").read_text())
    np.testing.assert_allclose(fields["handle"], 2.0 * np.array(line))
    assert main(new(made, *base, "--handle", "none")) == 3
    assert json.loads((made / "cup" / "clip.json").read_text())["handle"] == []
    for wrong, status, said in (("1,2", 2, "X,Y,Z"), ("a,b,c", 2, "X,Y,Z"), ("9,9,9", 1, "points within the mesh")):
        assert main(new(made, *base, "--handle", wrong)) == status
        assert said in capsys.readouterr().err


def test_a_kind_of_object_is_a_shape_of_the_package(
    made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its size is to be found, or stated; a file of that name comes first."""
    monkeypatch.chdir(made)
    base = ["--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "plate", "--overwrite"]
    assert main(new(made, *base)) == 3
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert (fields["category"], fields["scale"]) == ("plate", "free")
    assert "this package's own plate: a guess" in fields["provenance"]["mesh"]["text"]
    assert "warning: mesh: " in capsys.readouterr().err
    assert main(new(made, *base, "--category", "saucer", "--size-mm", "150")) == 3
    fields = json.loads((made / "cup" / "clip.json").read_text())
    assert (fields["category"], fields["scale"]) == ("saucer", "known")
    np.testing.assert_allclose(np.ptp(read_mesh(made / "cup" / "object.obj").vertices, axis=0).max(), 0.15)
    assert main(new(made, *base, "--known-scale")) == 2
    assert "--known-scale" in capsys.readouterr().err
    (made / "plate").write_text("no mesh")
    assert main(new(made, *base)) == 1
    assert "the suffix ''" in capsys.readouterr().err


def test_the_way_without_an_estimator_is_shown(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(new(made, "--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "mug")) == 3
    assert capsys.readouterr().err.count(f"getagrip annotate {made / 'video.mp4'}") == 2


def test_a_wrong_label_is_reported_before_there_are_hands(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    masks = ["--masks", str(made / "masks"), "--object", "7"]
    assert main(new(made, "--interval", "1", "3", "--side", "left", "--focal", "60", "--mesh", "mug", *masks)) == 1
    assert "there are 0, 1, 2" in capsys.readouterr().err
    assert not (made / "cup").exists()


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
    shown = VideoFootage(made / "turned.mp4")
    np.testing.assert_array_equal(shown.image(2), image)
    shown.close()


@pytest.mark.parametrize("option", ["--size-mm", "--diameter-mm"])
def test_sizes_are_refused_in_the_unit_in_which_they_are_given(made: Path, capsys: Any, option: str) -> None:
    mesh = ["--mesh", str(made / "unit.obj"), option, "0.25", "--interval", "1", "3", "--side", "left", "--K", *K]
    assert main(new(made, *mesh)) == 2
    assert f"{option} must be 5 to 2000 millimetres" in capsys.readouterr().err


def clip_of(made: Path, source: Path, first: int, last: int, *more: str) -> SimpleNamespace:
    """What ``clip.json`` says of a clip of some frames of a source, without masks and hands."""
    base = ["--interval", str(first), str(last), "--side", "right", "--mesh", "mug", "--focal", "200"]
    assert main(["clip", "new", str(source), "--out", str(made / "cup"), *base, *more]) == 3
    return SimpleNamespace(**json.loads((made / "cup" / "clip.json").read_text()))


def test_times_are_the_frames_own(made: Path) -> None:
    """Of two rates with a stall between them, from a time other than zero; the rate is that of most frames."""
    ticks = [100, *range(102, 130, 2), *range(160, 190, 3)]
    video = labelled_scene.write_video(made / "uneven.mp4", ticks, fps=60, frames=len(ticks))
    clip = clip_of(made, video, 3, 25)
    np.testing.assert_allclose(clip.times, (np.array(ticks[2:25]) - 100) / 60, atol=1e-3)
    assert clip.fps == pytest.approx(30.0)


def test_lens_distortion_is_removed_and_said(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(new(made, *everything(made), "--hands", str(made / "six.npz"))) == 0
    before = (made / "cup" / "frames" / "000003.jpg").read_bytes()
    lens = ["--distortion", "-0.2", "0.05", "0", "0", "--overwrite"]
    assert main(new(made, *everything(made), "--hands", str(made / "six.npz"), *lens)) == 0
    assert (made / "cup" / "frames" / "000003.jpg").read_bytes() != before
    assert "lens distortion removed from the images (OpenCV's model, -0.2 0.05 0 0)" in str(
        read_clip(made / "cup").provenance["camera"]
    )
    assert main(new(made, *everything(made), "--distortion", "0.1", "--overwrite")) == 2
    assert "--distortion must be 4 or 5" in capsys.readouterr().err


@pytest.mark.parametrize("prefix", ["", "frame_", "2026-rgb-"])
def test_a_folder_of_images_is_a_clip_of_its_names(made: Path, prefix: str) -> None:
    folder = made / "rgb"
    folder.mkdir()
    for n in (8, 9, 10, 11):
        write_image(folder / f"{prefix}{n}.png", labelled_scene.picture(n))
    clip = clip_of(made, folder, 1, 3, "--fps", "10")
    assert clip.frames == [f"{prefix}{n}" for n in (8, 9, 10)]
    np.testing.assert_allclose(clip.times, [0.0, 0.1, 0.2])
    for name, n in zip(clip.frames, (8, 9, 10), strict=True):
        assert labelled_scene.number_in((made / "cup" / "frames" / f"{name}.jpg").read_bytes()) == n


def test_folders_that_are_no_footage_are_refused_by_file(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, command = made / "rgb", ["--interval", "1", "2", "--side", "right", "--mesh", "mug", "--focal", "200"]
    folder.mkdir()
    cases: list[tuple[dict[str, tuple[int, int]], str]] = [
        ({}, "no images in it"),
        ({"1.png": (64, 256)}, "must be at least 2"),
        ({"1.png": (64, 256), "2.png": (32, 256)}, "must be 256 x 64"),
        ({"1.png": (64, 256), "1.jpg": (64, 256)}, "got several images of one frame, 1.jpg and 1.png"),
    ]
    for content, words in cases:
        for old in folder.iterdir():
            old.unlink()
        for name, shape in content.items():
            write_image(folder / name, np.zeros((*shape, 3), np.uint8))
        assert main(["clip", "new", str(folder), "--out", str(made / "cup"), *command]) == 1
        assert words in capsys.readouterr().err


@pytest.mark.parametrize("turned", [False, True])
def test_pixels_that_are_not_square_are_shown_square(made: Path, turned: bool) -> None:
    """The frames are as wide as players show them, upright or not; annotate shows them alike."""
    path = made / "narrow.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 48, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 48, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    if turned:
        write_turned(path, path)
    size = (48, 64) if turned else (64, 48)
    assert video_info(path).size == size
    shown = VideoFootage(path)
    assert shown.size == size
    shown.close()


def test_a_camera_of_other_images_is_said_when_the_clip_is_made(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(new(made, *everything(made), "--hands", str(made / "six.npz"), "--K", "90", "90", "48", "36")) == 3
    printed = capsys.readouterr().err
    assert "warning: camera: the principal point 48, 36" in printed
    assert "it fits images of 96 x 72" in printed


def test_hands_counted_from_another_start_are_asked_for(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of six hands the first is of frame 3, and is called 2."""
    hands = arrays.read(made / "six.npz", lambda _: True)
    arrays.write(made / "early.npz", hands | {"frames": np.arange(2, 8)})
    command = new(made, *everything(made), "--hands", str(made / "early.npz"))
    assert main(command) == 2
    assert "missing --hand-first: the number of the hand of frame 000003" in capsys.readouterr().err
    assert main([*command, "--hand-first", "2"]) == 0
    np.testing.assert_allclose(read_clip(made / "cup").hand.T_cam_hand, hands["T_cam_hand"])


def box(path: Path, size: float, more: str = "") -> Path:
    """A tetrahedron with three sides of a size."""
    corners = "".join("v {:g} {:g} {:g}\n".format(*point) for point in [np.zeros(3), *(size * np.eye(3))])
    path.write_text(corners + more + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return path


@pytest.mark.parametrize("more", ["v 0 0 9\n", "v 0 0 9\nv 0 0 8\nf 1 5 6\n"])
@pytest.mark.parametrize(("side", "diameter", "expected"), [(100.0, None, 0.1), (None, 100.0, 0.1 / np.sqrt(2))])
def test_sizes_are_those_of_the_surface(
    tmp_path: Path, more: str, side: float | None, diameter: float | None, expected: float
) -> None:
    made = read_own_mesh(MeshOptions(box(tmp_path / "a.obj", 0.3, more), side, diameter))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(expected)


@pytest.mark.parametrize(("unit", "size"), [("mm", 100.0), ("cm", 10.0), ("m", 0.1), ("in", 0.1 / 0.0254)])
def test_the_unit_of_a_file_is_stated(tmp_path: Path, unit: Unit, size: float) -> None:
    made = read_own_mesh(MeshOptions(box(tmp_path / "a.obj", size), unit=unit, known_scale=True))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(0.1, rel=1e-4)
    assert made.sized


def test_free_scale_needs_no_unit_and_known_scale_names_the_option(tmp_path: Path) -> None:
    path = box(tmp_path / "a.obj", 128.0)
    made = read_own_mesh(MeshOptions(path))
    assert not made.sized
    assert "rescaled" in str(made.provenance["scale"])
    with pytest.raises(InputError, match=r"--unit mm.*--size-mm"):
        read_own_mesh(MeshOptions(path, known_scale=True))
    with pytest.raises(InputError, match=r"millimetres\? .*getagrip clip new takes the unit \(--unit mm"):
        read_mesh(path)
    with pytest.raises(UsageError, match="--unit cannot be used"):
        read_own_mesh(MeshOptions(Path("mug"), unit="mm"))


def with_table(path: Path) -> Path:
    """A tetrahedron of 0.1, and under it a sheet of 0.24."""
    box(path, 0.1)
    sheet = [(-0.12, -0.12), (0.12, -0.12), (0.12, 0.12), (-0.12, 0.12)]
    corners = "".join(f"v {x} {y} -0.01\n" for x, y in sheet)
    path.write_text(path.read_text() + corners + "f 5 6 7\nf 5 7 8\n")
    return path


def test_sizes_are_of_the_part_that_is_held(tmp_path: Path) -> None:
    path = with_table(tmp_path / "scan.obj")
    with pytest.raises(UsageError, match=r"2 separate parts, 0.24 x 0.24 x 0, 0.1 x 0.1 x 0.1.*--part N.*--size-mm"):
        read_own_mesh(MeshOptions(path, 80.0))
    one, all_of = (read_own_mesh(MeshOptions(path, 80.0, part=part)) for part in ("2", "all"))
    assert np.ptp(one.mesh.vertices, axis=0).max() == pytest.approx(0.08)
    assert len(one.mesh.faces) == 4
    assert len(all_of.mesh.faces) == 6
    assert "2 separate parts" in str(read_own_mesh(MeshOptions(path)).provenance["mesh"])
    with pytest.raises(UsageError, match="--part must be 1 to 2"):
        read_own_mesh(MeshOptions(path, 80.0, part="3"))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_before_the_first_vertex_changes_nothing(tmp_path: Path, encoding: str) -> None:
    plain = box(tmp_path / "a.obj", 0.1, "v 0 0 0.05\n")
    (tmp_path / "b.obj").write_text(plain.read_text(), encoding=encoding)
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.obj").vertices, read_mesh(plain).vertices)
