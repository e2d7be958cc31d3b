"""The frame to draw on next, and the advice after a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.result import write_result
from getagrip.result.findings import Finding
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.next_step import (
    MASK_CONFIDENCE_THRESHOLD,
    MAX_SUGGESTED_FRAMES,
    MIN_MASK_IOU,
    discount_confidence,
    lost_frames,
    next_step,
    suggest_frame,
)
from helpers.clips import small_clip
from helpers.results import true_result

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


def test_the_next_step_is_a_frame_an_interval_a_mesh_and_a_command(tmp_path: Path) -> None:
    result = true_result(small_clip()[0], None)
    serious = Finding("mask-misfit", True, 9.0, 3.0, "wrong")
    mesh = tmp_path / "own.obj"
    mesh.touch()
    good = write_result(result, tmp_path / "good", "", {}, tmp_path)
    bad = write_result(replace(result, findings=(serious,)), tmp_path / "bad", "", {}, tmp_path)
    video, out, built_in = tmp_path / "a b.mp4", tmp_path / "out", RequestedMesh("mug", None)

    def said(result: Path, shape: RequestedMesh = built_in, wanted: int | None = 7, lost: tuple[int, ...] = ()) -> str:
        return next_step(result, video, out, shape, wanted, lost, (3, 90))

    assert said(good) == said(tmp_path / "none") == ""
    assert f"next: draw the object on frame 7, and reconstruct again, on the page: getagrip annotate '{video}'" in said(
        bad
    )
    assert "--interval FIRST LAST, if the object is grasped only in some of the frames 3 to 90" in said(bad)
    assert "--object FILE, the object's own mesh: the shape of mug is a guess" in said(bad)
    assert "--object FILE" not in said(bad, RequestedMesh(str(mesh), None))
    R = np.tile(np.eye(3), (40, 1, 1))
    R[25:] = se3.exp_so3(np.array([0.0, 1.0, 0.0]))
    names = tuple(f"{n:06d}" for n in range(3, 43))
    jumps = Finding("regrasp", False, 20.0, 6.0, "it jumps")
    long = replace(
        result, frames=names, frame_kind=("sampled",) * 40, T_hand_obj=se3.rigid(R, np.zeros((40, 3))), iou=np.ones(40),
        candidates=replace(result.candidates, T_hand_obj=se3.rigid(R, np.zeros((40, 3)))[None]), T_cam_hand=None,
        axis=None, findings=(serious, jumps),
    )  # fmt: skip
    step = next_step(
        write_result(long, tmp_path / "long", "", {}, tmp_path),
        video,
        out,
        built_in,
        7,
        (),
        (3, 42),
        (10.0, 20.0, 5.2, 6.0),
    )
    assert "--interval 3 27 --object-box 10,20,5,6: the object jumps in the hand between the frames 27 and 28" in step
    lost = said(good, lost=(8, 9, 10, 12))
    assert "the object is lost in the frames 8 to 10, 12\nnext: draw" in lost
    assert "--interval" not in lost
