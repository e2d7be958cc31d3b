"""Units of times, orders of quaternions, sizes of images, intrinsics and models: tested or asked for, never assumed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import write_clip
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.readers.cameras import read_camera_path
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.program_files import known, xyzw

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
