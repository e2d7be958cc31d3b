"""Paths of cameras, written as each program writes them: they come back as they were, recognised."""

from __future__ import annotations

import json
import re
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
from getagrip.readers.cameras import CameraPath, read_camera_path
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.program_files import FX, WRITERS, kitti, known, tum


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
