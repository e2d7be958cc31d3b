"""What speaks for and against candidates: the right one is preferred by numbers that need no ground truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.report.pages.candidates import (
    CANDIDATE_CRITERIA,
    compare_candidates,
    compute_candidate_metrics,
    weigh_candidate,
)
from helpers.results import OFF, view


@pytest.fixture(scope="module")
def known() -> list:
    return compute_candidate_metrics(view())


def test_the_right_candidate_meets_the_masks_and_the_wrong_one_does_not(known: list) -> None:
    right, wrong = known
    assert right.iou > 0.97 > wrong.iou + 0.2
    assert (right.excess, wrong.excess) == pytest.approx((0.0, 0.5))
    assert right.add == pytest.approx(0.0, abs=1e-6)
    assert wrong.add > 500.0 * OFF
    pro, con = weigh_candidate(known, 0)
    assert "lowest energy" in pro
    assert any("mask IOU" in text for text in pro)
    assert not any("mask IOU" in text for text in con)
    pro, con = weigh_candidate(known, 1)
    assert "energy 50 % above the lowest" in con
    assert any("mask IOU" in text for text in con)
    assert any("mask-fit" in text for text in con)


def test_ground_truth_is_shown_and_decides_nothing(known: list) -> None:
    blind = [replace(it, add=float("nan")) for it in known]
    assert weigh_candidate(blind, 1) == weigh_candidate(known, 1)


def test_candidates_that_differ_by_less_than_the_margins_have_nothing_for_or_against_them(known: list) -> None:
    right = known[0]
    alike = replace(
        right, excess=0.9 * CANDIDATE_CRITERIA[0].margin, iou=right.iou - 0.9 * CANDIDATE_CRITERIA[1].margin
    )
    assert weigh_candidate([right, alike], 0) == weigh_candidate([right, alike], 1) == ([], [])


def test_a_single_candidate_is_compared_with_nothing(known: list) -> None:
    assert weigh_candidate(known[:1], 0) == ([], [])


def test_a_table_has_the_columns_that_are_known(known: list) -> None:
    whole, blind = compare_candidates(view()), compare_candidates(replace(view(), masks=None))
    assert whole["head"] == ["", "energy", "IOU %", "gap mm", "depth mm", "SCA %", "ADD mm"]
    assert [row[1] for row in whole["rows"]] == ["100", "150"]
    assert (whole["pros"][1], whole["cons"][1]) == weigh_candidate(known, 1)
    assert blind["head"] == ["", "energy", "ADD mm"]


def test_without_masks_energies_are_all_there_is() -> None:
    right, wrong = compute_candidate_metrics(replace(view(), masks=None))
    assert np.isnan([right.iou, wrong.iou, right.gap, wrong.depth]).all()
    assert weigh_candidate([right, wrong], 1)[1] == ["energy 50 % above the lowest"]
