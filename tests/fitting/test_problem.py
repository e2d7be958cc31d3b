"""Clips on disk and clips in memory are prepared alike, and of long clips only sampled frames are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks, read_clip, read_masks, with_masks, write_clip
from getagrip.errors import InputError
from getagrip.fitting.evidence import silhouettes
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.io.images import PackedMask, read_mask
from getagrip.provenance import assumed
from getagrip.reconstruct import reconstruct
from helpers.clips import small_clip

FRAMES = 9


def written(folder: Path, unseen: list[int], hidden: list[int]) -> Clip:
    """A clip on disk: in some frames no pixel of the object is there, in others all are ignored."""
    clip, masks = small_clip(FRAMES)
    for n in range(FRAMES):
        masks.object[n] = np.roll(masks.object[n], n, axis=1)
    masks.object[unseen] = False
    masks.ignore[hidden] = True
    return read_clip(write_clip(clip, masks, folder))


def prepared(clip: Clip, options: Options, sampled: bool) -> Problem | str:
    """The problem, or what it is refused with."""
    try:
        return prepare_problem(clip if sampled else with_masks(clip, read_masks(clip)), options)
    except InputError as error:
        return str(error)


frame_numbers = st.lists(st.integers(0, FRAMES - 1), max_size=FRAMES)


@settings(max_examples=5)
@given(unseen=frame_numbers, hidden=frame_numbers, frames=st.integers(2, FRAMES + 3))
@pytest.mark.slow
def test_masks_read_in_part_are_those_read_whole(
    tmp_path_factory: Any, unseen: list[int], hidden: list[int], frames: int
) -> None:
    clip = written(tmp_path_factory.mktemp("clip") / "small", unseen, hidden)
    a, b = (prepared(clip, Options(frames=frames), sampled) for sampled in (True, False))
    if isinstance(a, str) or isinstance(b, str):
        assert a == b
        return
    assert a.clip.frames == b.clip.frames
    assert a.notes == b.notes
    gone = sorted({*unseen, *hidden})
    assert a.clip.left_out == tuple(clip.frames[n] for n in gone)
    np.testing.assert_array_equal(a.masks.object, b.masks.object)
    np.testing.assert_array_equal(a.masks.ignore, b.masks.ignore)
    np.testing.assert_array_equal(a.clip.hand.T_cam_hand, b.clip.hand.T_cam_hand)


def test_no_more_masks_are_in_memory_than_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = written(tmp_path / "small", [4], [])
    kept: list[int] = []

    read = silhouettes.read_object_masks

    def counted(clip: Clip) -> Masks:
        masks = read(clip)
        kept.append(len(masks.object))
        return masks

    monkeypatch.setattr(silhouettes, "read_object_masks", counted)
    problem = prepare_problem(clip, Options(frames=3))
    assert kept == [3]
    assert problem.clip.frames == ("0000", "0005", "0008")


def test_every_mask_is_checked_also_those_that_are_not_used(tmp_path: Path) -> None:
    clip = written(tmp_path / "small", [], [])
    for kind in ("object", "ignore"):
        path = clip.folder / "masks" / kind / "0001.png"
        whole = path.read_bytes()
        path.write_bytes(whole[:60])
        with pytest.raises(InputError, match=r"0001.png must be"):
            prepare_problem(clip, Options(frames=2))
        path.write_bytes(whole)
    prepare_problem(clip, Options(frames=2))


def test_frames_left_out_are_reported_once(tmp_path: Path) -> None:
    clip = replace(written(tmp_path / "small", [4], []), provenance={"scale": assumed("a guess")})
    problem = prepared(clip, Options(frames=3), sampled=True)
    assert not isinstance(problem, str)
    assert [note for note in problem.notes if "left out" in note] == [
        "1 frame without a mask that shows the object was left out of the fit: 0004"
    ]


@pytest.mark.parametrize(
    ("scale", "method", "times"), [("known", "static", 1), ("free", "static", 2), ("free", "paper", 1)]
)
def test_with_a_free_scale_there_are_twice_as_many_initial_poses(scale: Any, method: str, times: int) -> None:
    clip, masks = small_clip()
    options = Options(method=method, inits=7, hands="as-given")
    assert prepare_problem(with_masks(replace(clip, scale=scale), masks), options).options == replace(
        options, inits=times * 7
    )


def test_each_mask_of_a_short_clip_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip, read = written(tmp_path / "clip", [], []), list[Path]()

    def counted(path: Path, size: tuple[int, int]) -> PackedMask:
        read.append(path)
        return read_mask(path, size)

    monkeypatch.setattr("getagrip.clip.masks.read_mask", counted)
    reconstruct(clip, options=Options(frames=4, inits=5))
    assert sorted(read) == sorted((clip.origin / "masks").glob("*/*.png"))
