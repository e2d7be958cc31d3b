"""Stable contact of a timeline is that of its grasps, each with the hand that holds the object."""

from __future__ import annotations

from dataclasses import replace

import pytest

from getagrip.metrics.contact import ContactDefinition
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import SCA
from getagrip.result import SegmentResult
from helpers.scenes import by_other_hand, perfect, timeline

ANY = SegmentResult(state="grasp", first="0", last="1")
CONTACT = ContactDefinition("object", 0.010)


def test_a_grasp_in_a_timeline_counts_as_by_itself() -> None:
    clip, _ = timeline()
    result = replace(perfect(clip), segments=(ANY,))
    rows = clip.segments[2].rows
    whole = evaluate(result, clip, None, [CONTACT], [SCA])
    alone = evaluate(replace(result.take(rows), segments=()), clip, None, [CONTACT], [SCA])
    assert whole.metrics_of_grasps == pytest.approx(alone.metrics)
    assert whole.metrics[SCA.key(CONTACT)] < 0.5 * alone.metrics[SCA.key(CONTACT)]


def test_a_grasp_of_the_other_hand_is_measured_with_it() -> None:
    (own, _), (other, _) = timeline(), by_other_hand()
    known = own.segments[2].rows[other.hand_known("right")[own.segments[2].rows]]
    expected = evaluate(replace(perfect(own).take(known), segments=()), own, None, [CONTACT], [SCA]).metrics
    whole = evaluate(replace(perfect(other), segments=(ANY,)), other, None, [CONTACT], [SCA])
    assert whole.metrics_of_grasps == pytest.approx(expected) != whole.metrics
