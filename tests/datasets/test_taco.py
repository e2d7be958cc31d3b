"""TACO's sequences as GeneOH Diffusion holds them: on synthetic files with known answers, and on the real ones."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.datasets import cutting
from getagrip.datasets.taco import Taco
from getagrip.datasets.tracks import Track
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import generic
from helpers.held_ball import FRAMES, TAKEN, Hostile, ball, motion, synthetic_mano
from helpers.paths import folder_of


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder with one sequence: MANO's number of vertices, the translation is the wrist joint."""
    T_cam_hand, T_cam_obj = motion()
    model = synthetic_mano("right")
    content = {
        "hand_pose": np.concatenate([se3.log_so3(T_cam_hand[:, :3, :3]), np.zeros((FRAMES, 45))], axis=1),
        "hand_trans": se3.transform(T_cam_hand, generic.load("right").joints[:1])[:, 0],
        "hand_verts": se3.transform(T_cam_hand, model["v_template"]),
        "hand_faces": model["f"].astype(np.int64),
        "obj_pose": T_cam_obj,
    }
    (tmp_path / "a_1.pkl").write_bytes(pickle.dumps(content))
    ball(0.04).export(tmp_path / "a_1.obj")
    return tmp_path


def read(root: Path) -> Track:
    (source,) = Taco(root=root).sources()
    (track,) = source.read(lambda _: None)
    return track


def test_the_true_surface_in_the_hand_frame(root: Path) -> None:
    track = read(root)
    np.testing.assert_allclose(track.hand.T_cam_hand, motion()[0], atol=1e-9)
    np.testing.assert_allclose(track.hand.vertices[7], synthetic_mano("right")["v_template"], atol=1e-9)
    np.testing.assert_array_equal(track.T_cam_obj, motion()[1])
    assert set(track.hand.regions) == set(FINGERS)
    assert "guess" in track.provenance["camera"]
    assert "guess" in track.provenance["fps"]


def test_grasps_are_found(root: Path) -> None:
    (piece,) = cutting.pieces([read(root)], print, Taco(root=root).cut(print))
    assert piece.track.numbers[0] == TAKEN


def test_what_is_wrong_is_named_and_nothing_is_run(root: Path) -> None:
    file = root / "a_1.pkl"
    given = pickle.loads(file.read_bytes())
    for key, bad in (("obj_pose", 2.0 * given["obj_pose"]), ("hand_faces", given["hand_faces"] + 700)):
        file.write_bytes(pickle.dumps(given | {key: bad}))
        with pytest.raises(InputError, match=key):
            read(root)
    file.write_bytes(pickle.dumps(given | {"hand_trans": Hostile()}))
    with pytest.raises(InputError, match="nothing in it was run"):
        read(root)
    (root / "a_1.obj").unlink()
    with pytest.raises(InputError, match="source_data"):
        Taco(root=root).sources()


@folder_of("GETAGRIP_TACO")
def test_real_sequences(folder: Path) -> None:
    sources = Taco(root=folder).sources()
    assert len(sources) == 2
    for source in sources:
        (track,) = source.read(print)
        wrist = track.hand.vertices[:, 38]  # on MANO's rim at the wrist, which moves with the hand frame
        assert np.linalg.norm(wrist - wrist.mean(axis=0), axis=-1).max() < 2e-3
