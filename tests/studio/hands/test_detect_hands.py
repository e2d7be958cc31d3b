"""Hands that were found before anybody clicked: what the page draws, and what a clip is made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.io.images import write_image
from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, HandDetectionFiles
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL
from helpers.annotation import FIRST, LAST, Clicking, disc
from helpers.labelled_scene import HEIGHT, WIDTH, joints


def write_found(folder: Path) -> None:
    """Joints in all frames but the last one, and masks in those."""
    (folder / "masks").mkdir(parents=True)
    places = np.arange(FIRST + 1, LAST + 1)
    np.savez(folder / "hand.npz", frames=places, joints_2d=np.stack([joints(n - 1) for n in places]))
    for place in places:
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[: HEIGHT // 4] = 255
        write_image(folder / "masks" / f"{place:06d}.png", mask)


def test_nothing_is_found_without_a_folder(tmp_path: Path) -> None:
    found = HandDetectionFiles(tmp_path / DETECTED_HANDS_FOLDER)
    assert (found.joints, found.mask(3), found.word) == ({}, None, "")


def test_joints_and_masks_are_read_by_frames_from_0(tmp_path: Path) -> None:
    write_found(tmp_path / DETECTED_HANDS_FOLDER)
    found = HandDetectionFiles(tmp_path / DETECTED_HANDS_FOLDER)
    assert list(found.joints) == list(range(FIRST, LAST))
    np.testing.assert_allclose(found.joints[FIRST], joints(FIRST))
    mask = found.mask(FIRST)
    assert mask is not None
    assert mask[0].all()
    assert not mask[-1].any()
    assert found.mask(LAST) is None


def test_joints_of_another_shape_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "hand.npz", frames=np.array([1, 2]), joints_2d=np.zeros((2, 20, 2)))
    with pytest.raises(InputError, match="joints_2d"):
        _ = HandDetectionFiles(tmp_path).joints


@pytest.mark.slow
def test_a_hand_that_was_found_is_drawn_without_a_click_and_masks_have_it(clicking: Clicking) -> None:
    out = clicking.project.labelling.out
    with pytest.raises(RefusedError):
        clicking.project.work(clicking.about | {"work": "propagate"})
    write_found(out / DETECTED_HANDS_FOLDER)
    assert clicking.work("propagate")["state"] == "done"
    drafts = clicking.project.drafts(clicking.about, 0)["drafts"]
    assert {one["kind"] for one in drafts} == {"hand"}
    assert [len(one["content"]["joints"]) for one in drafts] == [21] * (LAST - FIRST) + [0]
    middle = np.mean(disc(FIRST)["the-disc"]["points"], axis=0).round().tolist()
    stroke = {"of": "on", "closed": True, "points": [middle]}
    clicking.click(FIRST, outlines={"a-stroke": stroke})
    assert clicking.work("propagate")["state"] == "done"
    masks = {
        one["frame"]: one["content"]
        for one in clicking.project.drafts(clicking.about, 0)["drafts"]
        if one["kind"] == "masks"
    }
    assert masks[FIRST]["object"]
    assert masks[FIRST]["hand"]
    assert (OBJECT_LABEL, OCCLUDER_LABEL, HAND_LABEL) == (1, 2, 3)
