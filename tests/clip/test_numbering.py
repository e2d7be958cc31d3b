"""Numbers that are counted from another start than the clip's frames."""

import pytest

from getagrip.clip.match_frames import check_frame_numbers, has_number_offset, renumber_frames
from getagrip.errors import UsageError


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
