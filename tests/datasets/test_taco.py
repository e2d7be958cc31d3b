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
from helpers.held_ball import TAKEN, Hostile, motion, synthetic_mano
from helpers.paths import folder_of
from helpers.taco_files import write_taco


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_taco(tmp_path)


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


@pytest.mark.slow
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
