"""Calibrations of several cameras, written as each program writes them: the same rig comes back."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.readers.cameras import Rig, read_rig
from helpers.rig_files import RIG_WRITERS, SIZE, K, known_rig, own_rig


@pytest.mark.parametrize("source", RIG_WRITERS)
def test_a_rig_comes_back(tmp_path: Path, source: str) -> None:
    write, names, lens = RIG_WRITERS[source]
    T = known_rig(len(names))
    rig = read_rig(write(tmp_path, T))
    assert rig.names == list(names)
    first = rig.cameras[0]
    for n, one in enumerate(rig.cameras):
        np.testing.assert_allclose(rig.T_own_view(first, one), se3.inverse(T[0]) @ T[n], atol=1e-7)
        found, distortion = rig.K_and_lens(one, SIZE)
        np.testing.assert_allclose(found, K, atol=1e-9)
        assert (distortion.distortion, distortion.fisheye) == lens
    if first.pinhole.size is None:
        return
    half, _ = rig.K_and_lens(first, (SIZE[0] // 2, SIZE[1] // 2))
    np.testing.assert_allclose(half, np.diag([0.5, 0.5, 1.0]) @ K, atol=1e-9)


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), min_size=2, max_size=4))
def test_any_rig_of_our_own_comes_back(tmp_path: Path, vectors: list[list[float]]) -> None:
    v = np.array(vectors)
    v[0, 3:], v[1, 3:] = 0.0, [0.5, 0.0, 0.0]
    T = se3.rigid(se3.exp_so3(v[:, :3]), v[:, 3:])
    rig = read_rig(own_rig(tmp_path, T))
    np.testing.assert_allclose([one.T_world_cam for one in rig.cameras], T, atol=1e-9)


def test_a_calibration_by_opencv_itself_is_read(tmp_path: Path) -> None:
    """Of a pair, as its sample writes it, in a board's millimetres: asked for, then taken."""
    T = known_rig(2)
    relative = se3.inverse(T[1]) @ T[0]
    for name, content in {
        "intrinsics.yml": {"M1": K - shift(), "D1": np.zeros((1, 5)), "M2": K - shift(), "D2": np.zeros((1, 5))},
        "extrinsics.yml": {"R": relative[:3, :3], "T": 1e3 * relative[:3, 3:], "Q": np.eye(4)},
    }.items():
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in content.items():
            storage.write(key, value)
        storage.release()
    with pytest.raises(InputError, match=r"must be 0\.005 to 20 m .*are these millimetres\? --metres 0\.001"):
        read_rig(tmp_path)
    rig = read_rig(tmp_path, metres=1e-3)
    assert (rig.names, rig.metric) == (["camera1", "camera2"], True)
    np.testing.assert_allclose(rig.T_own_view(*rig.cameras), se3.inverse(T[0]) @ T[1], atol=1e-7)


def shift() -> ndarray:
    return np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize("source", RIG_WRITERS)
@pytest.mark.parametrize("keep", [0.0, 0.4, 0.9])
def test_what_is_cut_short_is_refused(tmp_path: Path, source: str, keep: float) -> None:
    write, names, _ = RIG_WRITERS[source]
    place = write(tmp_path, known_rig(len(names)))
    for path in sorted(one for one in tmp_path.rglob("*") if one.is_file()):
        content = path.read_bytes()
        path.write_bytes(content[: int(keep * len(content))])
        with suppress(InputError, UsageError):
            assert isinstance(read_rig(place), Rig)
        path.write_bytes(content)


@pytest.mark.parametrize("source", RIG_WRITERS)
@pytest.mark.parametrize("number", ["0", "-1e308", "9" * 400, ".nan", "[" * 2000])
def test_impossible_numbers_are_refused(tmp_path: Path, source: str, number: str) -> None:
    write, names, _ = RIG_WRITERS[source]
    place = write(tmp_path, known_rig(len(names)))
    for path in sorted(one for one in tmp_path.rglob("*") if one.is_file()):
        content = path.read_text()
        found = list(re.finditer(r"-?\d+\.?\d*(e[-+]?\d+)?", content))
        for one in found[:: max(1, len(found) // 5)]:
            path.write_text(content[: one.start()] + number + content[one.end() :])
            with suppress(InputError, UsageError):
                read_rig(place)
        path.write_text(content)


def changed(change: Callable[[dict[str, dict[str, object]]], object], folder: Path) -> Path:
    path = own_rig(folder, known_rig(3))
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c["a"].pop("T_world_cam"), r"missing a\.T_world_cam"),
        (lambda c: c["a"].update(K=[1, 2]), r"a\.K must be numbers of shape \(3, 3\)"),
        (lambda c: c["a"].update(what=1), r"a\.what must be one of T_world_cam, K, fx"),
        (lambda c: c["a"].update(distortion=[0.1, 0.2]), r"a\.distortion must be 4 or 5 or 8 or 12 or 14 of OpenCV's"),
        (lambda c: c["a"]["T_world_cam"].__setitem__(0, [2, 0, 0, 0]), "must be a rotation and a translation"),
        (lambda c: [c.pop("b"), c.pop("c")], "must be 2 to 64, of different names"),
        (lambda c: c.update({"../x": c.pop("b")}), "one that can name a folder"),
        (lambda c: c["a"].update(size=[0, 480]), "width and height in pixels"),
        (lambda c: [one.update(T_world_cam=np.eye(4).tolist()) for one in c.values()], "0.005 to 20 m"),
    ],
)
def test_a_wrong_calibration_is_named(
    tmp_path: Path, change: Callable[[dict[str, dict[str, object]]], object], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        read_rig(changed(change, tmp_path))


def test_the_own_camera_is_named_or_the_only_one_left(tmp_path: Path) -> None:
    rig = read_rig(own_rig(tmp_path, known_rig(3)))
    assert rig.own(None, ["a", "c"]).name == "b"
    assert rig.own("c", ["a"]).name == "c"
    with pytest.raises(UsageError, match=r"missing --camera: .*: b, c"):
        rig.own(None, ["a"])
    with pytest.raises(UsageError, match="another camera than the views'"):
        rig.own("a", ["a"])
    with pytest.raises(UsageError, match="--camera"):
        rig.own("d", ["a"])
    with pytest.raises(InputError, match=r"are these images of a\?"):
        rig.K_and_lens(rig.cameras[0], (480, 640))


def test_what_is_no_rig_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.yaml").write_text("a: 1\n")
    with pytest.raises(InputError, match=r"kalibr \(camchain.yaml\).*of no known program"):
        read_rig(tmp_path / "x.yaml")
    (tmp_path / "x.yaml").write_text("a: &x 1\nb: *x\n")
    with pytest.raises(InputError, match="an alias"):
        read_rig(tmp_path / "x.yaml")


def test_a_camera_that_moves_is_no_camera_of_a_rig(tmp_path: Path) -> None:
    place = RIG_WRITERS["COLMAP"][0](tmp_path, known_rig(3))
    path = next(tmp_path.rglob("images.txt"))
    path.write_text(path.read_text().replace("b/0001.png", "a/0002.png"))
    with pytest.raises(InputError, match=r"a must be one that stands still: .*moves by"):
        read_rig(place)


def test_links_out_of_a_calibration_are_refused(tmp_path: Path) -> None:
    place = RIG_WRITERS["DexYCB"][0](tmp_path / "calibration", known_rig(3))
    path = sorted((tmp_path / "calibration" / "intrinsics").iterdir())[0]
    files.write_bytes(tmp_path / "outside.yml", path.read_bytes())
    path.unlink()
    path.symlink_to(tmp_path / "outside.yml")
    with pytest.raises(InputError, match="link"):
        read_rig(place)
