"""The HRDexDB reader, on small files of its layout with known answers, and on broken files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip import read_clip, read_masks
from getagrip.clip.views import views_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.hrdexdb import HrDexDb
from getagrip.readers.datasets.tracks import Track
from helpers.environment import Run
from helpers.hand_object_files import (
    HOCAP_BESIDE,
    HOCAP_WORLD,
    HOLOLENS_LOST,
    HRDEXDB_OBJECT,
    HRDEXDB_WORN,
    LOST,
    hololens_poses,
    write_hrdexdb,
)
from helpers.held_ball import FRAMES, TAKEN, motion, posed

NAME = "human--apple_0--apple--right"


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    return write_hrdexdb(tmp_path, mano)


def read(root: Path, mano: Path, notes: list[str] | None = None, **options: Any) -> list[Track]:
    (source,) = HrDexDb(root=root, mano=mano, **options).sources()
    return list(source.read((notes if notes is not None else []).append))


def scene(root: Path) -> Path:
    return root / "human" / HRDEXDB_OBJECT / "0"


@pytest.mark.slow
@pytest.mark.parametrize("viewers", [False, True])
def test_a_scene_is_a_track(tmp_path: Path, mano: Path, viewers: bool) -> None:
    write_hrdexdb(tmp_path, mano, viewers)
    (track,) = read(tmp_path, mano)  # the folder above it
    frames = np.arange(FRAMES) if viewers else np.delete(np.arange(FRAMES), LOST)
    np.testing.assert_array_equal(track.numbers, frames)
    assert (track.name, track.fps, track.size) == (NAME, 30.0, (640, 480))
    T_cam_hand, T_cam_obj = motion()
    np.testing.assert_allclose(track.T_cam_obj, T_cam_obj[frames], atol=1e-9)
    surface = se3.transform(track.hand.T_cam_hand, track.hand.vertices)
    bent = posed(mano, "right")[1]
    np.testing.assert_allclose(surface, se3.transform(T_cam_hand[frames], bent.vertices), atol=1e-8)
    turned = se3.angle_between(track.hand.T_cam_hand[:, :3, :3], T_cam_hand[frames, :3, :3])
    assert np.degrees(turned).max() < 3.0  # by the palm of the mean hand
    assert track.hand.joints is not None
    apart = se3.transform(track.hand.T_cam_hand, track.hand.joints) - se3.transform(T_cam_hand[frames], bent.joints)
    assert np.abs(apart).max() < 0.01
    assert track.world is not None
    np.testing.assert_allclose(track.world.T_world_cam[0], HOCAP_WORLD, atol=1e-9)
    np.testing.assert_allclose(track.world.up, [0.0, 0.0, -1.0])
    np.testing.assert_allclose(track.K, [[610.0, 0.0, 320.0], [0.0, 611.0, 240.0], [0.0, 0.0, 1.0]])


@pytest.mark.slow
def test_all_cameras_give_views(root: Path, mano: Path) -> None:
    notes: list[str] = []
    ((clip, _),) = clips(HrDexDb(root=root, mano=mano, views="all"), notes.append)
    assert clip.frames == tuple(f"{n:06d}" for n in range(TAKEN, LOST))
    beside, worn = sorted(views_of(clip), key=lambda view: view.name)
    assert (beside.name, worn.name) == ("22641023", HRDEXDB_WORN)
    assert [note for note in notes if "22640000: left out" in note]
    np.testing.assert_allclose(beside.T_cam_view[4], HOCAP_BESIDE, atol=1e-9)
    seen = np.arange(TAKEN, LOST) != HOLOLENS_LOST
    expected = np.linalg.inv(HOCAP_WORLD) @ hololens_poses()[TAKEN:LOST]
    np.testing.assert_allclose(worn.T_cam_view[seen], expected[seen], atol=1e-9)
    np.testing.assert_array_equal(worn.masks.known, seen)
    truth = clip.truth
    assert truth is not None
    for view in (worn, beside):
        T = np.linalg.inv(view.T_cam_view[5])
        of_object = se3.transform(T @ truth.T_cam_obj[5], clip.mesh.vertices), clip.mesh.faces
        of_hand = se3.transform(T @ truth.T_cam_hand[5], truth.hand_vertices[5]), clip.hand.faces
        near, far = (depth_and_face(v, f, view.K[5], view.size)[0] for v, f in (of_object, of_hand))
        np.testing.assert_array_equal(view.masks.object[5], near < far)


@pytest.mark.slow
def test_the_clip_s_camera_is_chosen(root: Path, mano: Path) -> None:
    (track,) = read(root, mano, camera="22641023")
    np.testing.assert_allclose(track.T_cam_obj[0], np.linalg.inv(HOCAP_BESIDE) @ motion()[1][0], atol=1e-9)
    (worn,) = read(root, mano, camera=HRDEXDB_WORN)
    np.testing.assert_array_equal(worn.numbers, [n for n in range(FRAMES) if n not in (LOST, HOLOLENS_LOST)])
    with pytest.raises(UsageError, match=f"--camera must be one of .*22640000, 22641005, 22641023, {HRDEXDB_WORN}"):
        read(root, mano, camera="other")


@pytest.mark.slow
def test_import_writes_clips(root: Path, mano: Path, tmp_path: Path, run: Run) -> None:
    assert run("import", "hrdexdb", root, "--mano", mano, "--views", "2", "--out", tmp_path / "out")[0] == 0
    clip = read_clip(tmp_path / "out" / NAME)
    assert read_masks(clip).object.any()
    assert [path.name for path in (tmp_path / "out" / NAME / "views").iterdir()] == ["22641023"]


@pytest.mark.slow
def test_what_a_scene_may_lack(root: Path, mano: Path, tmp_path: Path) -> None:
    (scene(root) / "C2R.npy").unlink()
    (scene(root) / "cam_param" / "ego_calib.json").unlink()
    (track,) = read(root, mano, views="all")
    assert track.world is not None
    assert track.world.up is None
    assert len(track.views) == 2
    next(root.glob("assets/*/*/*.obj")).unlink()
    notes: list[str] = []
    assert read(root, mano, notes) == []
    assert notes == ["apple/0: no poses of the object, or no mesh of the same version: skipped"]
    with pytest.raises(InputError, match="no human/<object>/<scene>/hand/mano"):
        HrDexDb(root=tmp_path / "mano", mano=mano).sources()
    with pytest.raises(UsageError, match="--mano: HRDexDB holds"):
        HrDexDb(root=root).sources()


def changed(file: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def of(folder: Path) -> None:
        path = folder / "cam_param" / file
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return of


def hand_file(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "hand" / "mano" / "00003.obj").write_text(text)


def left_hand(folder: Path) -> None:
    """The hand of the last frame mirrored."""
    path = folder / "hand" / "mano" / f"{FRAMES - 1:05d}.obj"
    path.write_text(path.read_text().replace("v -", "v +").replace("v 0", "v -0").replace("v +", "v "))


def poses(**changes: Any) -> Callable[[Path], None]:
    def of(folder: Path) -> None:
        path = folder.parents[2] / "object_6d_pose_v2" / "human" / "apple_0.npz"
        np.savez(path, **{**np.load(path), **changes})

    return of


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (hand_file("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"), "3 vertices"),
        (hand_file(""), "00003.obj"),
        (left_hand, "inside out"),
        (poses(frame_3=np.eye(3)), "frame_3"),
        (poses(frame_3=2.0 * np.eye(4)), "frame_3.*a rotation"),
        (poses(frame_3=np.full((4, 4), np.nan)), "frame_3.*NaN"),
        (changed("intrinsics.json", lambda of: of["22641005"].pop("intrinsics_undistort")), "intrinsics_undistort"),
        (changed("intrinsics.json", lambda of: of["22641005"].update(width=0)), "width"),
        (changed("intrinsics.json", lambda of: of.update({"22641005": 3})), "intrinsics of the camera"),
        (changed("intrinsics.json", lambda of: of.clear()), "no camera"),
        (changed("extrinsics.json", lambda of: of.update({"22641005": [[1, 0, 0], [0, 1, 0]]})), "3 x 4 or 4 x 4"),
        (changed("extrinsics.json", lambda of: of.update({"22641005": "here"})), "3 x 4 or 4 x 4"),
        (changed("ego_calib.json", lambda of: of.update(extrinsics=3)), "intrinsics and extrinsics by camera"),
        (changed("ego_calib.json", lambda of: of["extrinsics"][HRDEXDB_WORN].update({"5": [[0] * 4] * 3})), "5 must"),
        (lambda folder: np.save(folder / "C2R.npy", np.zeros((4, 4))), "C2R"),
    ],
)  # fmt: skip
def test_broken_files_are_named(root: Path, mano: Path, damage: Callable[[Path], object], named: str) -> None:
    damage(scene(root))
    with pytest.raises(InputError, match=named):
        read(root, mano, views="all")


def test_as_many_poses_as_hands(tmp_path: Path, mano: Path) -> None:
    root = write_hrdexdb(tmp_path, mano, viewers=True)
    (scene(root) / "object_6d" / "pose_000004.txt").unlink()
    with pytest.raises(InputError, match=r"31 poses"):
        read(root, mano)
    (scene(root) / "object_6d" / "pose_000004.txt").write_text("1 2 3")
    with pytest.raises(InputError, match=r"pose_000004.txt must be 16 numbers"):
        read(root, mano)
