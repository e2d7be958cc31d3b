"""TACO's sequences in GeneOH Diffusion's copy as tracks: a hand of known joints, and the real files if present."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import Side
from getagrip.readers.datasets.track_files import Tracks
from helpers.environment import DATA, folder_of, needs
from helpers.held_ball import Hostile, motion
from helpers.motion_capture_files import write_taco
from scripts.convert import taco

PUBLISHED = DATA / "mano" / "contact_regions.json"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_taco(tmp_path / "taco")


@pytest.mark.slow
def test_hand_and_object_are_where_they_are(root: Path, tmp_path: Path) -> None:
    taco.main(root, tmp_path / "tracks")
    (source,) = Tracks(root=tmp_path / "tracks").sources()
    (track,) = source.read(print)
    assert track.side == "left"
    np.testing.assert_array_equal(track.T_cam_obj, motion("left")[1])
    off = se3.inverse(track.hand.T_cam_hand) @ motion("left")[0]
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.01
    assert np.degrees(se3.angle_between(off[:, :3, :3], np.eye(3)).max()) < 8.0
    assert "guess" in str(track.provenance["camera"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hand_pose": np.zeros((32, 48))}, "fingers that move too little"),
        ({"obj_pose": np.zeros((9, 4, 4))}, "obj_pose"),
        ({"hand_trans": Hostile()}, "nothing in it was run"),
    ],
)
def test_what_is_wrong_is_named(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, object], said: str
) -> None:
    file = root / "a_1.pkl"
    file.write_bytes(pickle.dumps(pickle.loads(file.read_bytes()) | change))
    taco.main(root, tmp_path / "tracks")
    assert said in capsys.readouterr().err
    (root / "a_1.obj").unlink()
    with pytest.raises(SystemExit, match="source_data"):
        taco.main(root, tmp_path / "tracks")


@needs(PUBLISHED)
@folder_of("GETAGRIP_TACO")
def test_real_regions_are_about_those_that_the_authors_published(folder: Path) -> None:
    """Vertex ids of MANO's surface, which both hands share; by intersection over union."""
    published = [set(ids) for ids in json.loads(PUBLISHED.read_text())["verts"]]
    files = sorted(folder.glob("*.pkl"))
    assert len(files) == 2
    for file in files:
        _, vertices, pose, given = taco.read(file)
        flat = taco.flat_hand(vertices, generic.load("left").joints[0], pose)
        assert flat is not None
        regions = mano.mano_contact_regions(flat[0], np.array(given["hand_faces"]).astype(np.int64), *flat[1:])
        ours = [set(ids.tolist()) for ids in regions.values()]
        iou = np.array([[len(a & b) / len(a | b) for b in published] for a in ours])
        assert np.array_equal(iou.argmax(axis=1), np.arange(8))
        assert iou.diagonal()[:5].min() > 0.6
        assert iou.diagonal()[5:].min() > 0.25


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_is_found_behind_its_motion(side: Side) -> None:
    """Skinned as usual, its fingers bent in 40 ways: a vertex between two bones follows neither, so not exactly."""
    model = generic.load(side)
    rng = np.random.default_rng(0)
    pose = rng.normal(scale=0.12, size=(40, 15, 3))
    pose[..., 2] += (1.0 if side == "right" else -1.0) * rng.uniform(0.0, 1.0, (40, 15))
    moving = model.with_shape().with_pose(pose.reshape(40, 45))
    found = taco.flat_hand(moving.vertices, model.joints[0], pose.reshape(40, 45))
    assert found is not None
    template, joints, weights = found
    off = np.linalg.norm(joints - model.joints, axis=1)
    assert off[:13].max() < 1.5e-3
    assert off[13:].max() < 8e-3  # the thumb's, about whose saddle joint few vertices turn alone
    assert np.median(np.linalg.norm(template - model.template, axis=1)) < 1e-3
    assert np.mean(weights.argmax(axis=1) == model.weights.argmax(axis=1)) > 0.9
    expected = mano.mano_contact_regions(model.template, model.faces, model.joints, model.weights)
    for name, ids in mano.mano_contact_regions(template, model.faces, joints, weights).items():
        assert len(np.intersect1d(ids, expected[name])) > 0.7 * len(np.union1d(ids, expected[name])), name


def test_fingers_that_do_not_move_tell_nothing() -> None:
    model = generic.load("right")
    vertices, pose = np.tile(model.template, (9, 1, 1)), np.zeros((9, 45))
    assert taco.flat_hand(vertices, model.joints[0], pose) is None
