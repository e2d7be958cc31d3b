"""Masks of a clip: unknown ones, and pixels hidden by hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip import (
    Clip,
    Masks,
    find_masks,
    input_sha256,
    read_clip,
    read_masks,
    read_observed,
    with_masks,
    write_clip,
)
from getagrip.clip.clip import FrameMasks
from getagrip.clip.masks import occluded_by_hand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from helpers.clips import small_clip

GONE = [1, 3]


def sparse(masks: Masks) -> Masks:
    """The same, some not known."""
    frames = [FrameMasks(*each) for each in zip(masks.object, masks.ignore, strict=True)]
    size = masks.object.shape[2], masks.object.shape[1]
    return Masks.of(FrameMasks.unknown(size) if n in GONE else frame for n, frame in enumerate(frames))


@pytest.fixture
def some(tmp_path: Path) -> tuple[Clip, Masks]:
    """A clip whose folder lacks masks, and these."""
    clip, masks = small_clip(5)
    folder = write_clip(clip, masks, tmp_path / "clip")
    for kind in ("object", "ignore"):
        for n in GONE:
            (folder / "masks" / kind / f"{clip.frames[n]}.png").unlink()
    return read_clip(folder), sparse(masks)


def test_a_frame_without_a_file_is_not_known(some: tuple[Clip, Masks]) -> None:
    clip, expected = some
    for masks in (read_masks(clip), find_masks(clip)):
        assert masks is not None
        np.testing.assert_array_equal(masks.object, expected.object)
        np.testing.assert_array_equal(masks.ignore, expected.ignore)
        assert np.flatnonzero(~masks.known).tolist() == GONE
        assert masks.say_what_hides
    assert np.flatnonzero(~read_observed(clip)).tolist() == GONE


def test_writing_and_reading_keeps_what_is_not_known(some: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, masks = some
    folder = write_clip(clip, masks, tmp_path / "again")
    assert len(list((folder / "masks" / "object").iterdir())) == 3
    np.testing.assert_array_equal(read_masks(read_clip(folder)).ignore, masks.ignore)
    assert clip.folder is not None
    assert input_sha256(folder) == input_sha256(clip.folder)
    before = input_sha256(folder)
    (folder / "masks" / "object" / f"{clip.frames[0]}.png").unlink()
    assert input_sha256(folder) != before


def test_links_that_lead_nowhere_are_no_missing_files(some: tuple[Clip, Masks], refused: Callable[..., Any]) -> None:
    clip, _ = some
    assert clip.folder is not None
    name = f"masks/object/{clip.frames[1]}.png"
    (clip.folder / name).symlink_to(clip.folder / "nowhere.png")
    refused(lambda: read_masks(clip), name, "no such file")
    (clip.folder / name).unlink()
    for file in (clip.folder / "masks" / "object").iterdir():
        file.unlink()
    refused(lambda: read_masks(clip), "no mask of any frame")


def test_the_drawn_hand_does_not_make_it_known() -> None:
    clip, masks = small_clip(5)
    bare = sparse(replace(masks, ignore=np.zeros_like(masks.ignore)))
    assert not bare.say_what_hides
    drawn = occluded_by_hand(clip, bare)
    assert np.flatnonzero(~drawn.known).tolist() == GONE
    whole = occluded_by_hand(clip, Masks(masks.object, np.zeros_like(masks.ignore)))
    rest = [0, 2, 4]
    np.testing.assert_array_equal(np.asarray(drawn.ignore)[rest], np.asarray(whole.ignore)[rest])


def test_what_is_hidden_is_the_hand_but_for_the_object() -> None:
    clip, masks = small_clip(3)
    hidden = occluded_by_hand(clip, masks)
    for n, vertices in enumerate(se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)):
        hand = depth_and_face(vertices, clip.hand.faces, clip.K[n], clip.size)[1] >= 0
        np.testing.assert_array_equal(hidden.ignore[n] | (hand & masks.object[n]), hand)
    assert hidden.ignore.any()
    assert not (hidden.ignore & masks.object).any()
    assert hidden.object is masks.object


def test_the_hand_is_drawn_only_where_no_mask_says_what_is_hidden() -> None:
    clip, masks = small_clip(3)
    silent = Masks(masks.object, np.zeros_like(masks.ignore))
    assert any("rendered hand" in note for note in prepare_problem(with_masks(clip, silent), Options()).notes)
    marked = Masks(masks.object, silent.ignore.copy())
    marked.ignore[0, 0, 0] = True
    for given, options in ((marked, Options()), (silent, replace(Options(), occlusion=False))):
        problem = prepare_problem(with_masks(clip, given), options)
        assert not any("rendered hand" in note for note in problem.notes)
        np.testing.assert_array_equal(problem.masks.ignore, given.ignore)
