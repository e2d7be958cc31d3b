"""The HOI4D reader: on small files of its layout, with known answers, and on broken ones; it has met no real file."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.readers.datasets import cutting, tracks
from getagrip.readers.datasets.hoi4d import HOI4D_GRASP_OPTIONS, Hoi4d
from helpers.environment import Run
from helpers.hand_object_files import INDEX, NAME, write_hoi4d, write_labels
from helpers.held_ball import FRAMES, TAKEN, Hostile, ball, bent, motion, posed, same_points


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    return write_hoi4d(tmp_path, mano)


def read(root: Path, mano: Path) -> list[tracks.Track]:
    """The tracks of the one sequence."""
    (source,) = Hoi4d(root=root, mano=mano).sources()
    return list(source.read(lambda _: None))


@pytest.mark.slow
def test_poses_and_hands_are_those_that_were_written(root: Path, mano: Path) -> None:
    (track,) = read(root, mano)
    T_cam_hand, T_cam_obj = motion()
    assert track.name == NAME
    assert (track.size, track.fps) == ((960, 540), 15.0)
    np.testing.assert_allclose(track.K, [[500.0, 0.0, 480.0], [0.0, 505.0, 270.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(track.T_cam_obj, T_cam_obj, atol=1e-9)
    np.testing.assert_allclose(track.hand.T_cam_hand, T_cam_hand, atol=1e-6)
    np.testing.assert_allclose(track.hand.vertices[3], posed(mano, "right")[1].vertices, atol=1e-6)
    assert same_points(track.surface(7)[0], se3.transform(T_cam_obj[7], np.asarray(ball(0.03).vertices)), 1e-6)


@pytest.mark.slow
def test_left_hands_are_those_of_the_published_file(root: Path, mano: Path) -> None:
    left = root / "handpose" / "refinehandpose_left" / INDEX
    left.mkdir(parents=True)
    for file in (root / "handpose" / "refinehandpose_right" / INDEX).iterdir():
        given = pickle.loads(file.read_bytes())
        given["poseCoeff"][3:] = bent("left")
        (left / file.name).write_bytes(pickle.dumps(given))
    track, _ = read(root, mano)
    assert track.side == "left"
    np.testing.assert_allclose(track.hand.vertices[3], posed(mano, "left")[1].vertices, atol=1e-6)


@pytest.mark.slow
def test_frames_without_a_hand_are_gaps(root: Path, mano: Path) -> None:
    (root / "handpose" / "refinehandpose_right" / INDEX / "28.pickle").unlink()
    notes: list[str] = []
    for whole, first in ((False, TAKEN), (True, 0)):
        before, after = cutting.cut_into_grasps(read(root, mano), notes.append, HOI4D_GRASP_OPTIONS.cut(print), whole)
        np.testing.assert_array_equal(before.track.numbers, np.arange(first, 28))
        np.testing.assert_array_equal(after.track.numbers, np.arange(29, FRAMES))


@pytest.mark.parametrize("kind", ["mask", "shift_mask"])
@pytest.mark.slow
def test_labels_are_masks(root: Path, mano: Path, kind: str) -> None:
    write_labels(root, kind)
    (piece,) = cutting.cut_into_grasps(read(root, mano), print, HOI4D_GRASP_OPTIONS.cut(print))
    few = replace(piece, track=piece.track.take(np.arange(2)))
    clip, masks = cutting.clip_of_piece(few, 2, print)
    assert "drawn by people" in clip.provenance["masks"]
    seen, ignore = masks.object[0], masks.ignore[0]
    assert seen.shape == (540, 960)
    assert seen[50:101, 150:200].all()  # half of the last row's pixels are the object's
    assert seen.sum() == 51 * 50
    assert ignore[150:200, 150:200].all()
    assert ignore.sum() == 50 * 50 + 50 * 51
    assert masks.hand is not None
    assert masks.hand[0][150:200, 150:200].all()  # the right hand's label
    assert masks.hand[0].sum() == 50 * 50


@pytest.mark.slow
def test_masks_are_rendered_where_there_are_none(root: Path, mano: Path, tmp_path: Path) -> None:
    assert import_clips(Hoi4d(root=root, mano=mano), tmp_path / "out", debug=False) == 0
    clip = read_clip(tmp_path / "out" / NAME)
    assert "rendered" in clip.provenance["masks"]
    assert read_masks(clip).object.any(axis=(1, 2)).all()


def test_objects_with_joints_are_left_out(root: Path, mano: Path) -> None:
    notes: list[str] = []
    (root / "HOI4D_CAD_Model_for_release" / "rigid" / "Bottle" / "011.obj").unlink()
    (source,) = Hoi4d(root=root, mano=mano).sources()
    assert list(source.read(notes.append)) == []
    assert "Bottle/011.obj" in notes[0]


OBJPOSE = f"HOI4D_annotations/{INDEX}/objpose/7.json"
HAND = f"handpose/refinehandpose_right/{INDEX}/7.pickle"


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        (OBJPOSE, b"{}", "objects"),
        (OBJPOSE, b"[1", "invalid JSON"),
        (OBJPOSE, b'{"objects": []}', "objects"),
        (OBJPOSE, b'{"objects": [{"center": {"x": 0, "y": 0, "z": 1}}]}', r"objects\[0\].rotation"),
        (OBJPOSE, b'{"objects": [{"rotation": {"x": 0, "y": 0, "z": NaN}}]}', "NaN"),
        (OBJPOSE, b'{"dataList": [{"rotation": {"x": 0, "y": 0, "z": true}}]}', r"dataList\[0\].rotation"),
        (HAND, b"", "does not load"),
        (HAND, pickle.dumps({"poseCoeff": np.zeros(48)}), "missing trans"),
        (HAND, pickle.dumps({"poseCoeff": np.zeros(47)}), "poseCoeff"),
        (HAND, pickle.dumps({"poseCoeff": np.full(48, np.inf)}), "poseCoeff"),
        (HAND, pickle.dumps({"poseCoeff": Hostile()}), "nothing in it was run"),
        (HAND, pickle.dumps([1]), "dictionary"),
        ("camera_params/ZY20210800001/intrin.npy", b"\x93NUMPY", "header"),
        ("HOI4D_CAD_Model_for_release/rigid/Bottle/011.obj", b"f 1 2 3", "vertex 3"),
    ],
)
@pytest.mark.slow
def test_broken_files_are_named(root: Path, mano: Path, name: str, content: bytes, named: str) -> None:
    (root / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{Path(name).name}.*{named}"):
        read(root, mano)


@pytest.mark.slow
def test_broken_labels_are_named(root: Path, mano: Path) -> None:
    write_labels(root)
    path = root / "HOI4D_annotations" / INDEX / "2Dseg" / "mask" / "00007.png"
    content = path.read_bytes()
    cv2.imwrite(str(path), np.zeros((540, 960, 3), np.uint8))
    small = path.read_bytes()
    for damaged in (content[: len(content) // 2], b"", small):
        path.write_bytes(damaged)
        (piece,) = cutting.cut_into_grasps(read(root, mano), print, HOI4D_GRASP_OPTIONS.cut(print))
        with pytest.raises(InputError, match=r"00007\.png"):
            cutting.clip_of_piece(piece, 20, print)


@pytest.mark.slow
def test_wrong_calls_are_refused(root: Path, mano: Path, tmp_path: Path, run: Run) -> None:
    with pytest.raises(UsageError, match="--mano: HOI4D"):
        Hoi4d(root=root).sources()
    with pytest.raises(InputError, match="objpose"):
        Hoi4d(root=tmp_path / "mano", mano=mano).sources()
    status, printed, err = run("import", "hoi4d", root, "--mano", mano, "--view", 1, "--out", tmp_path / "out")
    assert (status, printed) == (2, "")
    assert "--view" in err
    assert not (tmp_path / "out").exists()
