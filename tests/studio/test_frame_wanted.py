"""The frame that is asked for next."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from getagrip.studio.masks.suggest_frame import (
    MASK_CONFIDENCE_THRESHOLD,
    MAX_SUGGESTED_FRAMES,
    MIN_MASK_IOU,
    discount_confidence,
    lost_frames,
    suggest_frame,
)

FIRST, LAST = 10, 60


def unsure(*worst: int, width: int = 6) -> dict[int, float]:
    """Confidence that is low about some frames."""
    nearest = {n: min(abs(n - one) for one in worst) for n in range(FIRST, LAST + 1)}
    return {n: min(1.0, 0.6 + 0.4 * distance / width) for n, distance in nearest.items()}


def test_the_ends_are_asked_for_first() -> None:
    assert suggest_frame({}, [], FIRST, LAST) == FIRST
    assert suggest_frame({}, [20], FIRST, LAST) == LAST
    assert suggest_frame({}, [50], FIRST, LAST) == FIRST


def test_where_the_object_is_lost_is_asked_for_before_all_else() -> None:
    sure = dict.fromkeys(range(FIRST, LAST + 1), 0.9) | dict.fromkeys(range(30, LAST + 1), 0.0)
    assert suggest_frame(sure, [FIRST], FIRST, LAST) == 30
    assert suggest_frame(sure | {LAST: 1.0}, [FIRST, LAST], FIRST, LAST) in (30, LAST - 1)
    assert lost_frames(sure) == [*range(30, LAST + 1)]


def test_the_middle_of_the_longest_unsure_part_is_asked_for() -> None:
    """Not the least certain frame, where it stands alone: the frames about it are mended, too."""
    sure = unsure(35)
    assert suggest_frame(sure, [FIRST, LAST], FIRST, LAST) == 35
    alone = sure | {50: 0.3}
    assert abs((suggest_frame(alone, [FIRST, LAST], FIRST, LAST) or 0) - 35) <= 3


def test_nothing_is_asked_for_while_masks_are_made_or_where_they_are_sure_enough() -> None:
    sure = unsure(35)
    assert suggest_frame({n: c for n, c in sure.items() if n != 40}, [FIRST, LAST], FIRST, LAST) is None
    assert suggest_frame(dict.fromkeys(sure, MASK_CONFIDENCE_THRESHOLD), [FIRST, LAST], FIRST, LAST) is None
    assert suggest_frame(sure, range(FIRST, FIRST + MAX_SUGGESTED_FRAMES), FIRST, LAST) is None


@given(st.sets(st.integers(FIRST, LAST), min_size=2, max_size=MAX_SUGGESTED_FRAMES - 1), st.integers(FIRST, LAST))
def test_a_frame_that_is_drawn_is_not_asked_for_again(drawn: set[int], worst: int) -> None:
    asked = suggest_frame(unsure(worst), drawn, FIRST, LAST)
    assert asked is None or (FIRST <= asked <= LAST and asked not in drawn)


@given(st.sets(st.integers(FIRST, LAST), max_size=MAX_SUGGESTED_FRAMES), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_masks_are_less_sure_where_a_result_meets_them_less_than_drawn_ones(
    drawn: set[int], met: float, times: float
) -> None:
    """Not where it meets the drawn ones as badly: then shape or hand is wrong; nothing is known without drawn ones."""
    sure, alike = dict.fromkeys(range(FIRST, LAST + 1), 0.98), dict.fromkeys(range(FIRST, LAST + 1), met)
    assert discount_confidence(sure, alike, drawn) == sure
    assert discount_confidence(sure, {}, drawn) == sure
    less = {n: met if n in drawn else times * met for n in sure}
    expected = min(0.98, max(times * met, MIN_MASK_IOU) / max(met, MIN_MASK_IOU)) if drawn else 0.98
    found = discount_confidence(sure, less, drawn)
    assert all(abs(found[n] - (0.98 if n in drawn else expected)) < 1e-9 for n in sure)
