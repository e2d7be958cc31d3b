"""Segments of a timeline: their states, frames and files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import Clip, OtherHand, Segment, State, World, input_sha256, read_clip, write_clip
from getagrip.clip.read import read_header
from getagrip.clip.timeline import STATES, at_frames
from getagrip.clip.write import write_hand
from getagrip.errors import InputError, UsageError
from getagrip.readers.masks.mask_regions import decode_region, decode_run_lengths, fill_polygons
from helpers.clips import small_clip
from helpers.program_files import SIZE, encoded


def test_polygons_fill_the_pixels_whose_centres_they_hold() -> None:
    square = fill_polygons(Path("c.json"), "s", [[3.0, 2.0, 9.0, 2.0, 9.0, 6.0, 3.0, 6.0]], SIZE)
    expected = np.zeros(SIZE[::-1], dtype=bool)
    expected[2:6, 3:9] = True
    inner = np.zeros_like(expected)
    inner[3:5, 4:8] = True
    assert square[inner].all()
    assert np.count_nonzero(square != expected) <= 2 * (6 + 4) + 4  # the border's own pixels, at most
    everything = fill_polygons(Path("c.json"), "s", [[-20, -14, 40, -14, 40, 28, -20, 28]], SIZE)
    assert everything.all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.booleans())
def test_run_lengths_come_back(seed: int, share: float, compressed: bool) -> None:
    mask = np.random.default_rng(seed).random(SIZE[::-1]) < share
    np.testing.assert_array_equal(decode_run_lengths(Path("c"), "s", encoded(mask, compressed), SIZE), mask)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.sampled_from(["size", "counts", "x"]), inner),
    max_leaves=20,
)


@settings(max_examples=200, deadline=None)
@given(JUNK | st.fixed_dictionaries({"size": st.just([14, 20]), "counts": JUNK | st.text("0123456789:;<=>?@PQRSTUVo")}))
@pytest.mark.slow
def test_any_segmentation_is_read_or_refused(value: Any) -> None:
    try:
        assert decode_region(Path("c.json"), "annotations[0].segmentation", value, SIZE).shape == SIZE[::-1]
    except InputError as error:
        assert "annotations[0].segmentation" in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    "segmentation",
    [
        [[1, 1, 2, 2]],
        [[float("inf"), 1, 2, 2, 3, 3]],
        [[1e9, 1, 2, 2, 3, 3]],
        [["a", 1, 2, 2, 3, 3]],
        [[1, 1, 2, 2, 3, 3, 4]],
        {"size": [14, 21], "counts": [294]},
        {"size": [14, 20], "counts": [2**62, 2**62]},
        {"size": [14, 20], "counts": [-1, 281]},
        {"size": [14, 20], "counts": "o" * 100},
        {"size": [14, 20], "counts": "\u00ff"},
    ],
)
def test_impossible_segmentations(refused: Callable[..., str], segmentation: Any) -> None:
    refused(lambda: decode_region(Path("c.json"), "annotations[7]", segmentation, SIZE), "c.json", "annotations[7]")


SEGMENTS = (
    Segment("static", 0, 1),
    Segment("contact", 2, 2, "right"),
    Segment("grasp", 3, 5, "right"),
    Segment("free", 7, 7),
)


@pytest.fixture
def timeline() -> Clip:
    """Eight frames: lying, touched, held, unknown, thrown."""
    clip, _ = small_clip(8)
    world = World(np.tile(np.eye(4), (8, 1, 1)), np.array([0.0, -1.0, 0.0]), -0.25)
    return replace(clip, world=world, segments=SEGMENTS, truth=None)


@pytest.fixture
def folder(timeline: Clip, tmp_path: Path) -> Path:
    return write_clip(timeline, None, tmp_path / "clip")


def test_what_is_written_is_read(timeline: Clip, folder: Path) -> None:
    clip = read_clip(folder)
    assert (clip.segments, clip.world) == (SEGMENTS, timeline.world)
    assert json.loads((folder / "clip.json").read_text())["segments"][1] == {
        "state": "contact", "first": "0002", "last": "0002", "side": "right",
    }  # fmt: skip


def test_the_other_hand_is_kept_in_its_own_frames(timeline: Clip, tmp_path: Path) -> None:
    rows = np.array([1, 4, 5])
    other = OtherHand.at(timeline.hand.take(rows), rows, len(timeline))
    folder = write_clip(replace(timeline, other_hand=other), None, tmp_path / "two")
    back = read_clip(folder)
    assert back.other_hand == other
    np.testing.assert_array_equal(other.track.T_cam_hand, timeline.hand.T_cam_hand[[1, 1, 1, 4, 4, 5, 5, 5]])
    assert timeline.side == "right"
    assert back.take(np.array([1, 6])).hand_known("left").tolist() == [True, False]
    swapped = back.with_side("left")
    assert swapped is not None
    assert (swapped.hand, swapped.side) == (other.track, "left")
    checksum = input_sha256(folder)
    (folder / "other_hand.npz").write_bytes((folder / "hand.npz").read_bytes())
    assert input_sha256(folder) != checksum
    (folder / "other_hand.npz").write_bytes(b"")
    with pytest.raises(InputError, match=r"other_hand\.npz"):
        read_clip(folder)


def test_older_versions_have_none(folder: Path) -> None:
    fields = json.loads((folder / "clip.json").read_text())
    del fields["segments"], fields["camera"]["world_support"]
    (folder / "clip.json").write_text(json.dumps(fields | {"version": 2}))
    clip = read_clip(folder)
    assert clip.segments == ()
    assert clip.world is not None
    assert clip.world.support is None


def test_frames_without_a_hand_leave_the_rest_of_their_segments(timeline: Clip, folder: Path) -> None:
    rows = np.array([1, 4, 5, 7])
    write_hand(timeline.take(rows).hand, folder / "hand.npz", {"frames": np.array([timeline.frames[n] for n in rows])})
    assert read_clip(folder).segments == timeline.take(rows).segments
    assert [(s.state, s.first, s.last) for s in read_clip(folder).segments] == [
        ("static", 0, 0), ("grasp", 1, 2), ("free", 3, 3),
    ]  # fmt: skip


@given(st.lists(st.tuples(st.sampled_from(STATES), st.integers(0, 2), st.integers(1, 4))), st.sets(st.integers(0, 40)))
def test_each_frame_keeps_its_state(input_segments: list[tuple[State, int, int]], chosen: set[int]) -> None:
    segments, at = [], 0
    for state, gap, length in input_segments:
        first = at + gap
        segments.append(Segment(state, first, first + length - 1, "left" if state == "grasp" else None))
        at = first + length
    state_of = {n: s for s in segments for n in s.rows}
    index = np.array(sorted(chosen), dtype=int)
    some = {n: s for s in at_frames(segments, index) for n in s.rows}
    for row, n in enumerate(index):
        before, after = state_of.get(int(n)), some.get(row)
        assert (before and (before.state, before.side)) == (after and (after.state, after.side))


def test_in_another_order_there_are_no_segments(timeline: Clip) -> None:
    assert timeline.take(np.arange(8)[::-1]).segments == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"state": "held"}, ("segments[2].state", "'held'", "static, contact, grasp, free")),
        ({"state": None}, ("segments[2].state", "static, contact, grasp, free")),
        ({"side": "both"}, ("segments[2].side", "'both'", "left or right")),
        ({"side": None}, ("segments[2].side", "left or right")),
        ({"state": "free"}, ("segments[2].side", "'right'", "no hand moves")),
        ({"first": "0005", "last": "0004"}, ("segments[2].last", "'0004' before '0005'")),
        ({"first": "0002"}, ("segments[2].first", "'0002'", "a frame after '0002'")),
        ({"first": 3}, ("segments[2].first", "got 3", "the name of one of the clip's frames")),
        ({"last": "frame"}, ("segments[2].last", "'frame'")),
        ({"last": ["0005"]}, ("segments[2].last", "the name")),
        ({"colour": "red"}, ("segments[2].colour", "unknown key")),
    ],
)
def test_what_is_wrong_is_named(folder: Path, change: dict[str, Any], words: tuple[str, ...]) -> None:
    fields = json.loads((folder / "clip.json").read_text())
    fields["segments"][2] |= change
    (folder / "clip.json").write_text(json.dumps(fields))
    for read in (read_clip, read_header):
        with pytest.raises(InputError) as caught:
            read(folder)
        assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("input_segments", [5, [1], {"static": [0, 1]}, "static"])
def test_segments_are_a_list_of_objects(folder: Path, input_segments: object) -> None:
    fields = json.loads((folder / "clip.json").read_text()) | {"segments": input_segments}
    (folder / "clip.json").write_text(json.dumps(fields))
    with pytest.raises(InputError, match="a list of"):
        read_clip(folder)


def test_what_lies_still_needs_a_world(folder: Path) -> None:
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    with pytest.raises(InputError, match=r"segments\[0\]\.state must be .*T_world_cam.*got static"):
        read_clip(folder)


@pytest.mark.parametrize(
    "segments",
    [(Segment("free", 0, 8),), (Segment("free", 0, 3), Segment("contact", 3, 5)), (Segment("static", 0, 1),)],
)
def test_clips_in_memory_are_checked_alike(segments: tuple[Segment, ...]) -> None:
    with pytest.raises(UsageError, match=r"Clip\.segments"):
        replace(small_clip(8)[0], segments=segments)


def test_a_segment_is_one_that_can_be() -> None:
    for state, first, last, side in (
        ("held", 0, 1, None), ("grasp", 0, 1, None), ("static", 0, 1, "left"), ("free", 2, 1, None),
        ("free", -1, 1, None),
    ):  # fmt: skip
        with pytest.raises(UsageError, match="Segment"):
            Segment(state, first, last, side)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"World\.support"):
        World(np.eye(4)[None], None, 0.5)
