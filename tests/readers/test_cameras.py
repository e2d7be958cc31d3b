"""Camera trajectories, written in each program's format: they come back unchanged, and the format is recognised.

Units of time, orders of quaternions, image sizes, intrinsics and models are tested or asked for, never assumed."""

from __future__ import annotations

import json
import re
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import read_clip, write_clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io import arrays
from getagrip.readers.cameras import CameraPath, colmap, read_camera_path
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.program_files import FX, WRITERS, kitti, known, tum, xyzw


@pytest.mark.parametrize("source", WRITERS)
def test_a_path_comes_back(tmp_path: Path, source: str) -> None:
    write, words, metric = WRITERS[source]
    found = read_camera_path(write(tmp_path, known()))
    assert words in found.source
    assert found.metric == metric
    np.testing.assert_allclose(found.T_world_cam, known(), atol=1e-9)
    if found.pinhole is not None:
        assert abs(found.pinhole.K[0, 0] - FX) < 1e-9
        assert found.pinhole.distorted == (source == "COLMAP, text")
    assert (found.up is not None) == (source in ("ARKit", "Aria", "Record3D"))
    if found.names:
        poses, filled = found.at([f"{n:06d}" for n in (2, 3, 5)], np.zeros(3), None)
        np.testing.assert_allclose(poses, known()[[1, 2, 4]], atol=1e-9)
        assert not filled.any()


@pytest.mark.parametrize("source", WRITERS)
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_what_is_cut_short_or_changed_is_refused(tmp_path: Path, source: str, keep: float) -> None:
    """Each file in turn: an error of ours, or another path, never anything else."""
    place = WRITERS[source][0](tmp_path, known())
    for path in sorted(one for one in tmp_path.rglob("*") if one.is_file()):
        content = path.read_bytes()
        path.write_bytes(content[: int(keep * len(content))])
        with suppress(InputError, UsageError):
            assert isinstance(read_camera_path(place), CameraPath)
        path.write_bytes(content)


@given(st.lists(st.booleans(), min_size=6, max_size=6))
def test_frames_between_others_are_interpolated(kept: list[bool]) -> None:
    """A camera that turns and moves at constant speed has its own pose in every frame; ends are never made up."""
    steps = np.arange(8)[:, None]
    T = se3.rigid(se3.exp_so3(steps * [0.05, 0.1, 0.0]), steps * [0.1, 0.0, 0.05])
    rows = [0, *(n + 1 for n, keep in enumerate(kept) if keep), 7]
    names = tuple(f"{n:06d}" for n in range(8))
    found = CameraPath("a test", Path("x"), T[rows], tuple(names[row] for row in rows))
    poses, filled = found.at(names, np.zeros(8), None)
    np.testing.assert_allclose(poses, T, atol=1e-9)
    assert filled.tolist() == [n not in rows for n in range(8)]
    with pytest.raises(InputError, match="no pose of frame 000007"):
        CameraPath("a test", Path("x"), T[:3], names[:3]).at(names, np.zeros(8), None)


def test_poses_with_times(tmp_path: Path) -> None:
    found = read_camera_path(tum(tmp_path, known(31)))
    poses, _ = found.at(["000004", "000005"], np.array([0.1, 0.1 + 1 / 30.0]), 0.0)
    np.testing.assert_allclose(poses, known(31)[3:5], atol=1e-6)
    with pytest.raises(UsageError, match="--start S"):
        found.at(["000004", "000005"], np.array([0.1, 0.2]), None)
    with pytest.raises(InputError, match="is --start right"):
        found.at(["000004", "000005"], np.array([0.1, 0.2]), 60.0)


@pytest.mark.parametrize("source", WRITERS)
@pytest.mark.parametrize("number", ["0", "-1e308", "1e400", "9" * 400, "nan", "[" * 5000])
def test_impossible_numbers_are_refused_in_a_line(tmp_path: Path, source: str, number: str) -> None:
    """In place of every number of a text, one after the other: an error that names the file, or another path."""
    place = WRITERS[source][0](tmp_path, known())
    for path in sorted(one for one in tmp_path.rglob("*") if one.is_file() and one.suffix not in (".bin", ".npz")):
        content = path.read_text()
        found = list(re.finditer(r"-?\d+\.?\d*(e[-+]?\d+)?", content))
        for one in (*found[:16], *found[-16:]):
            path.write_text(content[: one.start()] + number + content[one.end() :])
            with suppress(InputError, UsageError):
                read_camera_path(place)
        path.write_text(content)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("1 EVIL 640 480 600 600 320 240", "a camera EVIL of 4 parameters"),
        ("1 PINHOLE 640 480 600 600 320", "a camera PINHOLE of 3 parameters"),
        ("1 PINHOLE 0 0 600 600 320 240", "a size in pixels"),
        ("1 PINHOLE 640 480 nan 600 320 240", "focal lengths above 0"),
        ("1 PINHOLE 640 480 -600 600 320 240", "focal lengths above 0"),
    ],
)
def test_impossible_cameras_are_refused(tmp_path: Path, line: str, says: str) -> None:
    place = WRITERS["COLMAP, text"][0](tmp_path, known())
    next(tmp_path.rglob("cameras.txt")).write_text(f"{line}\n")
    with pytest.raises(InputError, match=says):
        read_camera_path(place)


def test_numbers_of_images_below_0_are_refused(tmp_path: Path) -> None:
    place = WRITERS["ViPE"][0](tmp_path, known())
    arrays.write(tmp_path / "pose" / "video.npz", {"data": known(), "inds": -np.arange(1, 6)})
    with pytest.raises(InputError, match="inds must be a number from 0 on for each pose"):
        read_camera_path(place)


def test_what_nobody_knows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(InputError, match=r"colmap.*kitti.*no known program"):
        read_camera_path(tmp_path / "x.txt")
    with pytest.raises(InputError, match="no such file"):
        read_camera_path(tmp_path / "none")


@pytest.mark.slow
def test_the_command(tmp_path: Path, run: Run) -> None:
    clip, masks = small_clip()
    folder = write_clip(clip, masks, tmp_path / "clip")
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    path = kitti(tmp_path, known(len(clip)))
    status, out, err = run("import", "cameras", str(path), "--clip", str(folder))
    assert (status, "its scale is not known, a guess" in err, "in 3 frames" in out) == (3, True, True)
    world = read_clip(folder).world
    assert world is not None
    np.testing.assert_allclose(world.T_world_cam, known(len(clip)), atol=1e-9)
    assert run("import", "cameras", str(path), "--clip", str(folder))[0] == 2
    again = ("import", "cameras", str(path), "--clip", str(folder), "--overwrite", "--metres", "0.5")
    assert run(*again)[0] == 0
    world = read_clip(folder).world
    assert world is not None
    np.testing.assert_allclose(world.T_world_cam[:, :3, 3], 0.5 * known(len(clip))[:, :3, 3], atol=1e-9)


FRAMES, TIMES = [f"{n:06d}" for n in range(1, 4)], np.arange(3) / 30.0
COUNT = 40


def lines(path: Path, unit: float, start: float, w_first: bool, separator: str = " ", head: str = "") -> np.ndarray:
    """Lines of a camera at 30 frames per second, and its path."""
    T = known(COUNT)
    T[:, :3, :3] = T[0, :3, :3].T @ T[:, :3, :3]
    q = xyzw(T)[:, [3, 0, 1, 2]] if w_first else xyzw(T)
    times = [f"{round((start + n / 30.0) / unit)}" if unit != 1.0 else f"{start + n / 30.0:.6f}" for n in range(COUNT)]
    rows = [separator.join([t, *(f"{x:.9f}" for x in (*M[:3, 3], *o))]) for t, M, o in zip(times, T, q, strict=True)]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n")
    return T


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("since", [0.0, 1403636579.0])
@pytest.mark.parametrize("in_file", [False, True])
def test_units_of_times_are_seen(tmp_path: Path, unit: float, since: float, in_file: bool) -> None:
    """--start may be given in seconds, or as it is in the file."""
    T = lines(tmp_path / "a.txt", unit, since, False)
    start = since + 10 / 30.0
    poses, _ = read_camera_path(tmp_path / "a.txt").at(FRAMES, TIMES, start / unit if in_file else start)
    assert np.abs(poses[:, :3, 3] - T[10:13, :3, 3]).max() < 2e-3  # milliseconds are rounded
    if unit < 1e-3:
        assert np.abs(se3.inverse(poses) @ T[10:13] - np.eye(4)).max() < 1e-3


@pytest.mark.parametrize("w_first", [False, True])
@pytest.mark.parametrize(
    ("head", "separator", "unit"),
    [
        ("", " ", 1.0),
        ("", ",", 1e-9),
        ("# timestamp tx ty tz {}", " ", 1.0),
        ("#timestamp [ns],p_x,p_y,p_z,{}", ",", 1e-9),
    ],
)
def test_orders_of_quaternions_are_seen(tmp_path: Path, w_first: bool, head: str, separator: str, unit: float) -> None:
    names = "qw qx qy qz" if w_first else "qx qy qz qw"
    head = head.format(names if separator == " " else "q_" + ",q_".join(names.replace("q", "").split()))
    T = lines(tmp_path / "a.csv", unit, 1403636579.0, w_first, separator, head)
    np.testing.assert_allclose(read_camera_path(tmp_path / "a.csv").T_world_cam, T, atol=1e-6)


def test_unclear_orders_are_asked_for(tmp_path: Path) -> None:
    rows = np.hstack([np.arange(3)[:, None] / 30.0, np.zeros((3, 3)), np.full((3, 4), 0.5)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    with pytest.raises(UsageError, match="--quaternion xyzw"):
        read_camera_path(tmp_path / "a.csv")
    turned = read_camera_path(tmp_path / "a.csv", "wxyz")
    np.testing.assert_allclose(turned.T_world_cam[0, :3, :3], se3.from_quaternion(np.full(4, 0.5)))
    np.save(tmp_path / "b.npy", rows)
    np.savez(tmp_path / "c.npz", cam_c2w=known())
    with pytest.raises(UsageError, match="--quaternion cannot be used"):
        read_camera_path(tmp_path / "c.npz", "wxyz")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A clip of three frames, 32 x 24, focal length 40 px, without a camera's path."""
    made = write_clip(small_clip()[0], None, tmp_path / "clip")
    fields = json.loads((made / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (made / "clip.json").write_text(json.dumps(fields))
    return made


def transforms(path: Path, focals: tuple[float, ...], size: tuple[int, int] = (64, 48)) -> Path:
    """A file of nerfstudio with its own focal length for each frame."""
    lens = {"cx": size[0] / 2, "cy": size[1] / 2, "w": size[0], "h": size[1]}
    frames = [
        {"file_path": f"images/{n:04d}.jpg", "transform_matrix": T.tolist(), "fl_x": f, "fl_y": f}
        for n, (f, T) in enumerate(zip(focals, known(3), strict=True))
    ]
    path.write_text(json.dumps({**lens, "frames": frames}))
    return path


def test_intrinsics_are_those_of_each_frame(tmp_path: Path, folder: Path, run: Run) -> None:
    """At the size of the clip's images, half of the files'."""
    call = ("import", "cameras", transforms(tmp_path / "transforms.json", (90.0, 95.0, 100.0)), "--clip", folder)
    status, _, err = run(*call)
    assert status == 3
    assert "focal length 45 to 50 px in the files" in err
    status, _, err = run(*call, "--intrinsics", "--overwrite")
    K = np.array(json.loads((folder / "clip.json").read_text())["camera"]["K"])
    np.testing.assert_allclose(K[:, 0, 0], [45.0, 47.5, 50.0])


@pytest.mark.parametrize("size", [(48, 64), (96, 48)])
def test_images_of_another_shape_are_refused(tmp_path: Path, folder: Path, run: Run, size: tuple[int, int]) -> None:
    path = transforms(tmp_path / "transforms.json", (90.0,) * 3, size)
    status, _, err = run("import", "cameras", path, "--clip", folder)
    assert status == 1
    assert "32 x 24: neither cropped nor turned" in err
    assert "{} x {} pixels".format(*size) in err


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--intrinsics",), "have no intrinsics"),
        (("--start", "3"), "its poses have no times"),
        (("--images", "cam1"), "its poses have no names"),
    ],
)
def test_options_that_files_cannot_serve_are_errors(
    tmp_path: Path, folder: Path, run: Run, option: tuple[str, ...], words: str
) -> None:
    np.savez(tmp_path / "x.npz", cam_c2w=known(3))
    status, _, err = run("import", "cameras", tmp_path / "x.npz", "--clip", folder, *option)
    assert status == 2
    assert words in err


def test_the_model_that_has_the_frames_is_used(tmp_path: Path, folder: Path, run: Run) -> None:
    world = se3.inverse(known(3))
    q = se3.quaternion(world[:, :3, :3])
    for number, names in enumerate((["room_100", "room_101"], ["0000", "0001", "0002"])):
        model = tmp_path / "sparse" / str(number)
        model.mkdir(parents=True)
        poses = [" ".join(map(repr, (*q[n].tolist(), *world[n, :3, 3].tolist()))) for n in range(len(names))]
        model.joinpath("images.txt").write_text(
            "".join(f"{n + 1} {pose} 1 {name}.jpg\n\n" for n, (name, pose) in enumerate(zip(names, poses, strict=True)))
        )
        model.joinpath("cameras.txt").write_text("1 PINHOLE 32 24 40 41 16 12\n")
    status, _, err = run("import", "cameras", tmp_path, "--clip", folder)
    assert status == 3
    assert "2 models" in err
    found = np.array(json.loads((folder / "clip.json").read_text())["camera"]["T_world_cam"])
    np.testing.assert_allclose(found, known(3), atol=1e-9)


@pytest.mark.parametrize("kind", colmap.COLMAP_CAMERA_MODELS)
def test_a_camera_behind_another_is_read(kind: int) -> None:
    name, count = colmap.COLMAP_CAMERA_MODELS[kind]
    first = struct.pack("<IiQQ", 1, kind, 640, 480) + np.arange(100.0, 100.0 + count).tobytes()
    behind = struct.pack("<IiQQ", 2, 1, 640, 480) + np.array([500.0, 501.0, 320.0, 240.0]).tobytes()
    cameras = dict(colmap._cameras_bin(struct.pack("<Q", 2) + first + behind))
    np.testing.assert_array_equal(cameras[2].K, [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]])
    assert cameras[1].K[0, 0] == 100.0
    assert cameras[1].K[1, 2] == (102.0 if name in colmap.SINGLE_FOCAL_MODELS else 103.0)
    assert cameras[1].distorted == (name not in ("PINHOLE", "SIMPLE_PINHOLE"))
