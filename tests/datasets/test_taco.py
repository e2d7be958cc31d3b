"""TACO's sequences as GeneOH Diffusion holds them: on synthetic files with known answers, and on the real ones."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.datasets import cutting
from getagrip.datasets.taco import Taco
from getagrip.datasets.tracks import Track
from getagrip.errors import InputError
from getagrip.hands import generic
from getagrip.hands.model import PALM_REGIONS
from helpers.held_ball import TAKEN, Hostile, motion, synthetic_mano
from helpers.paths import DATA, folder_of, needs
from helpers.taco_files import write_taco

PUBLISHED = DATA / "mano" / "contact_regions.json"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_taco(tmp_path)


def read(root: Path) -> Track:
    (source,) = Taco(root=root).sources()
    (track,) = source.read(lambda _: None)
    return track


def test_the_true_surface_in_the_hand_frame(root: Path) -> None:
    track = read(root)
    np.testing.assert_allclose(track.hand.T_cam_hand, motion("left")[0], atol=1e-9)
    np.testing.assert_allclose(track.hand.vertices[7], synthetic_mano("left")["v_template"], atol=1e-9)
    np.testing.assert_array_equal(track.T_cam_obj, motion("left")[1])
    assert track.side == "left"
    assert set(track.hand.regions) == set(FINGERS)  # its fingers do not move
    assert "guess" in str(track.provenance["camera"])
    assert "guess" in str(track.provenance["fps"])


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
        assert tuple(track.hand.regions) == (*FINGERS, *PALM_REGIONS)
        flat = generic.load("left").template  # thumb, fingers and palm lie as a left hand's do
        assert np.linalg.norm(track.hand.vertices.mean(axis=(0, 1)) - flat.mean(axis=0)) < 0.04


@needs(PUBLISHED)
@folder_of("GETAGRIP_TACO")
def test_real_regions_are_about_those_that_the_authors_published(folder: Path) -> None:
    """Vertex ids of MANO's surface, which both hands share; by intersection over union."""
    published = [set(ids) for ids in json.loads(PUBLISHED.read_text())["verts"]]
    for source in Taco(root=folder).sources():
        (track,) = source.read(print)
        ours = [set(ids.tolist()) for ids in track.hand.regions.values()]
        iou = np.array([[len(a & b) / len(a | b) for b in published] for a in ours])
        assert np.array_equal(iou.argmax(axis=1), np.arange(8))
        assert iou.diagonal()[:5].min() > 0.6
        assert iou.diagonal()[5:].min() > 0.25
