"""The HO-Cap reader, on small files of its layout with known answers, and on broken files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import read_clip, read_masks
from getagrip.clip.views import views_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.hocap import HoCap
from getagrip.readers.datasets.tracks import Track
from helpers.environment import Run
from helpers.hand_object_files import (
    HOCAP_BESIDE,
    HOCAP_META,
    HOCAP_SERIALS,
    HOCAP_WORLD,
    HOLOLENS,
    HOLOLENS_LOST,
    LEFT_FROM,
    LOST,
    hololens_poses,
    left_hand_poses,
    write_hocap,
)
from helpers.held_ball import FRAMES, TAKEN, motion, posed

NAME = "subject_1--20231025_165502--G01_1--right"


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    return write_hocap(tmp_path, mano)


def read(root: Path, mano: Path, notes: list[str] | None = None, **options: Any) -> list[Track]:
    (source,) = HoCap(root=root, mano=mano, **options).sources()
    return list(source.read((notes if notes is not None else []).append))


@pytest.mark.slow
def test_every_hand_is_read_with_every_object(root: Path, mano: Path) -> None:
    notes: list[str] = []
    tracks = read(root, mano, notes)
    assert [(track.category, track.side) for track in tracks] == [
        ("G01_1", "left"), ("G01_1", "right"), ("G01_2", "left"), ("G01_2", "right")
    ]  # fmt: skip
    assert [note.partition(": ")[2] for note in notes] == ["no mesh of G01_3: it is skipped and hides nothing"]
    T_cam_hand, T_cam_obj = motion()
    left, right = tracks[:2]
    assert (right.name, right.size, right.fps) == (NAME, (640, 480), 30.0)
    np.testing.assert_array_equal(right.numbers, np.delete(np.arange(FRAMES), LOST))
    np.testing.assert_array_equal(left.numbers, np.delete(np.arange(LEFT_FROM, FRAMES), LOST - LEFT_FROM))
    for track, T in ((right, T_cam_hand), (left, left_hand_poses())):
        np.testing.assert_allclose(track.hand.T_cam_hand, T[track.numbers], atol=1e-6)
        np.testing.assert_allclose(track.hand.vertices[3], posed(mano, track.side)[1].vertices, atol=1e-6)
        np.testing.assert_allclose(track.T_cam_obj, T_cam_obj[track.numbers], atol=1e-6)
    np.testing.assert_allclose(right.K, [[616.0, 0.0, 320.0], [0.0, 616.0, 240.0], [0.0, 0.0, 1.0]])
    assert right.world is not None
    np.testing.assert_allclose(right.world.T_world_cam[0], HOCAP_WORLD, atol=1e-9)
    np.testing.assert_array_equal(right.world.up, [0.0, 0.0, 1.0])


@pytest.mark.slow
def test_all_cameras_give_views(root: Path, mano: Path) -> None:
    """The HoloLens has no masks in the frame in which its pose is unknown."""
    found = {clip.name: clip for clip, _ in clips(HoCap(root=root, mano=mano, views="all"))}
    clip = found[NAME]
    assert clip.frames == tuple(f"{n:06d}" for n in range(TAKEN, LOST))
    worn, beside = sorted(views_of(clip), key=lambda view: view.name, reverse=True)
    assert (beside.name, worn.name, worn.size) == (HOCAP_SERIALS[1], HOLOLENS, (320, 240))
    np.testing.assert_allclose(beside.T_cam_view[4], HOCAP_BESIDE, atol=1e-9)
    expected = np.linalg.inv(HOCAP_WORLD) @ hololens_poses()[TAKEN:LOST]
    seen = np.arange(TAKEN, LOST) != HOLOLENS_LOST
    np.testing.assert_allclose(worn.T_cam_view[seen], expected[seen], atol=1e-6)
    np.testing.assert_array_equal(worn.masks.known, seen)
    assert clip.truth is not None
    truth = clip.truth
    for view in (worn, beside):
        for n in (0, len(clip) - 1):
            T = np.linalg.inv(view.T_cam_view[n])
            surfaces = [
                (T @ truth.T_cam_obj[n], clip.mesh.vertices, clip.mesh.faces),
                (T @ truth.T_cam_hand[n], truth.hand_vertices[n], clip.hand.faces),
            ]
            if n:
                left = posed(mano, "left")[1]
                surfaces.append((T @ left_hand_poses()[TAKEN + n], left.vertices, left.faces))
            depth = np.stack([depth_and_face(se3.transform(M, v), f, view.K[n], view.size)[0] for M, v, f in surfaces])
            visible = (depth.argmin(axis=0) == 0) & np.isfinite(depth[0])
            assert (view.masks.object[n] != visible).sum() < 4  # float32 poses
            assert visible.sum() > 80
    provenance = str(clip.provenance)
    assert "CC BY 4.0" in provenance
    assert "RealSense" in provenance


@pytest.mark.slow
def test_the_clip_s_camera_is_chosen(root: Path, mano: Path) -> None:
    right = read(root, mano, view=2)[1]
    T = np.linalg.inv(HOCAP_BESIDE) @ motion()[1]
    np.testing.assert_allclose(right.T_cam_obj, T[right.numbers], atol=1e-6)
    worn = read(root, mano, view=0)[1]
    assert worn.size == (320, 240)
    np.testing.assert_array_equal(worn.numbers, [n for n in range(FRAMES) if n not in (LOST, HOLOLENS_LOST)])
    for view, kind in ((3, InputError), (-1, UsageError)):
        with pytest.raises(kind, match="--view"):
            read(root, mano, view=view)
    (root / "subject_1" / "20231025_165502" / "poses_pv.npy").unlink()
    assert len(read(root, mano)) == 4  # it is not needed
    with pytest.raises(InputError, match="poses_pv"):
        read(root, mano, view=0)


@pytest.mark.slow
def test_import_writes_clips(root: Path, mano: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    assert run("import", "hocap", root, "--mano", mano, "--views", "2", "--out", out)[0] == 0
    clip = read_clip(out / NAME)
    assert read_masks(clip).object.any()
    assert len(list((out / NAME / "views").iterdir())) == 1
    assert import_clips(HoCap(root=root, mano=mano, whole=True), tmp_path / "whole", debug=False) == 0


def test_the_first_release_is_named(root: Path, mano: Path) -> None:
    meta = root / "subject_1" / "20231025_165502" / "meta.yaml"
    meta.rename(meta.with_suffix(".json"))
    with pytest.raises(InputError, match=r"meta\.json, of HO-Cap's first release, which is not read"):
        HoCap(root=root, mano=mano).sources()
    meta.with_suffix(".json").unlink()
    with pytest.raises(InputError, match=r"no meta\.yaml in it"):
        HoCap(root=root, mano=mano).sources()
    with pytest.raises(UsageError, match="--mano: HO-Cap holds"):
        HoCap(root=root).sources()


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        (f"num_frames: {FRAMES}", "num_frames: 31", "poses_m.npy"),
        (f"num_frames: {FRAMES}", "num_frames: 10000000", "num_frames"),
        (f"num_frames: {FRAMES}", "num_frames: true", "num_frames"),
        ("G01_2", "G01_1", "object_ids"),
        ("G01_2", "../../etc", "object_ids"),
        ("[right, left]", "right", "mano_sides"),
        ("subject_id: subject_1", "subject_id: ../subject_1", "subject_id"),
        ("extrinsics_20231014.yaml", "../extrinsics.yaml", "extrinsics"),
        ("extrinsics_20231014.yaml", "other.yaml", "other.yaml"),
        ("  width: 640", "  width: wide", "width"),
        ("realsense:", "other:", "realsense"),
        ("hololens:", "other:", "hololens"),
        (HOCAP_SERIALS[1], "1234", "extrinsics.1234"),
        ("task_id: 1", "task_id: [1", "invalid plain YAML"),
    ],
)
def test_a_broken_description_is_named(root: Path, mano: Path, old: str, new: str, named: str) -> None:
    meta = root / "subject_1" / "20231025_165502" / "meta.yaml"
    assert old in HOCAP_META
    meta.write_text(HOCAP_META.replace(old, new))
    with pytest.raises(InputError, match=named):
        read(root, mano, views="all")


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("poses_m", lambda a: a[:1], r"poses_m.*\(2, 32, 51\)"),
        ("poses_m", lambda a: np.where(np.arange(51) == 7, np.nan, a), "poses_m.*NaN"),
        ("poses_o", lambda a: 0.5 * a, "poses_o.*a quaternion of length 0.5"),
        ("poses_o", lambda a: a[:2], r"poses_o.*\(3, 32, 7\)"),
        ("poses_o", lambda a: a.astype(int), "poses_o"),
        ("poses_pv", lambda a: a[:, :6], r"poses_pv.*\(32, 7\)"),
        ("poses_pv", lambda a: a * 0.0, "poses_pv.*length 0"),
    ],
)
def test_broken_poses_are_named(root: Path, mano: Path, name: str, change: Any, named: str) -> None:
    path = root / "subject_1" / "20231025_165502" / f"{name}.npy"
    np.save(path, change(np.load(path)))
    with pytest.raises(InputError, match=named):
        read(root, mano, views="all")
