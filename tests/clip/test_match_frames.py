"""Files of other programs matched to frames by their names and numbers."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip.match_frames import (
    check_frame_numbers,
    frame_of,
    has_number_offset,
    matching_names,
    number_in,
    pattern_of,
    renumber_frames,
)
from getagrip.errors import UsageError

FRAMES = tuple(f"{n:06d}" for n in range(1, 31))


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("000001_jpg.rf.9f86d081884c7d659a2feaa0c55ad015", 1),
        ("000001_jpg.rf.AbC9zQ12", 1),
        ("000001-550e8400-e29b-41d4-a716-446655440000", 1),
        ("550e8400-000001", 1),
        ("000001_640x480", 1),
        ("000001_20250131", 1),
        ("000001_20250131T120000", 1),
        ("000001_abcdef12", 1),
        ("face0012", 12),
        ("image_9f86d081884c7d12", None),
        ("9f86d081884c7d65", None),
        ("cam2_v2f0001", 1),
        ("frame_0000000743", 743),
        ("000743_0", 743),
        ("cam_01", 1),
        ("000001_object0", 1),
        ("000012_mask", 12),
        ("000012_class_mug", 12),
        ("clip2_mask_000743", 743),
        ("task-41-annotation-101-by-1-tag-mug-0", 41),
    ],
)
def test_numbers_are_those_of_frames(name: str, number: int | None) -> None:
    assert number_in(name) == number


@given(st.integers(1, 30), st.binary(), st.sampled_from(["_", "-", ".", "_jpg.rf."]), st.sampled_from([8, 12, 32, 40]))
def test_a_hash_behind_the_name_changes_nothing(n: int, content: bytes, separator: str, length: int) -> None:
    code = hashlib.sha256(content).hexdigest()[:length]
    if not code.isdigit():
        assert frame_of(f"{n:06d}{separator}{code}", FRAMES) == n - 1
    assert frame_of(f"image_{code}a1f", FRAMES) is None


def test_dates_are_frames_where_frames_are_dates() -> None:
    assert frame_of("000001_20250131", ("20250131", "20250201")) == 0
    assert frame_of("cam0_1234567890123", ("234567890122", "234567890123")) == 1


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("rgb_000001.png", "rgb_*"),
        ("cam0/000001_object1.png", "cam0/*_object1"),
        ("000001_thumb.jpg", "*_thumb"),
        ("1403636579.763555.png", "*.*"),
        ("task-41-annotation-101-by-1-tag-mug-0.png", "*-tag-mug-*"),
    ],
)
def test_sets_of_images_have_a_pattern(name: str, pattern: str) -> None:
    assert pattern_of(name) == pattern
    assert matching_names([name, "other.png"], pattern) == [0]


def names(first: int, last: int, form: str = "{:06d}") -> list[str]:
    return [form.format(n) for n in range(first, last + 1)]


@pytest.mark.parametrize(("first", "last"), [(0, 29), (0, 24), (0, 400), (1, 25), (2, 31), (20, 40)])
def test_numbers_that_fit_by_luck_are_asked_for(first: int, last: int) -> None:
    frames = names(6, 30) if first < 2 else names(1, 30)
    for form in ("{:06d}", "{:06d}_0", "frame_{:010d}"):
        assert has_number_offset(frames, names(first, last, form))


@pytest.mark.parametrize(("first", "last"), [(6, 30), (8, 30), (6, 20), (1, 400), (1, 30), (6, 60)])
def test_the_frames_own_numbers_are_not(first: int, last: int) -> None:
    assert not has_number_offset(names(6, 30), names(first, last))
    assert not has_number_offset([f"image-{n}-a" for n in range(3)], names(first, last))


def test_the_question_says_what_each_answer_would_do() -> None:
    with pytest.raises(UsageError, match="30, 29 of 30 frames") as error:
        check_frame_numbers(names(1, 30), names(0, 29), "a.csv", "pose", "--first")
    assert "pose of frame 000001: in a.csv they are numbered 0 to 29" in str(error.value)
    check_frame_numbers(names(1, 30), names(0, 29), "a.csv", "pose", "")


def test_frames_are_renumbered_with_their_gaps() -> None:
    assert renumber_frames(["000006", "000008"], 0, "--first") == ("000000", "000002")
    with pytest.raises(UsageError, match="have no numbers"):
        renumber_frames(["a"], 0, "--first")
