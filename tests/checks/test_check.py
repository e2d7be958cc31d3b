"""Messages of checks: counts, lengths and fractions with their units, and advice."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.checks import INPUT_CHECKS, RESULT_CHECKS, Evidence, input_checks, result_checks, run_checks
from getagrip.checks.check import OWN_MESH_ADVICE
from getagrip.checks.timeline_checks import FLOATING_CHECK, JUMP_CHECK
from getagrip.io.files import to_json
from getagrip.provenance import assumed
from getagrip.result.findings import read_findings
from helpers.clips import small_clip

CLIP, MASKS = small_clip()
BUILT_IN = replace(CLIP, provenance={"mesh": assumed("this package's own mug: a guess of the object's shape")})
OF_SHAPE = {"mask-fit", "poor-mask-fit", "large-mask-misfit", "mask-misfit", "mesh-much-deformed", "mesh-deformed"}


def test_advice_asks_no_question() -> None:
    checks = [*input_checks(), *result_checks()]
    assert [c.name for c in checks if "?" in c.advice and not c.name.startswith("depth")] == []


@pytest.mark.parametrize("name", sorted(OF_SHAPE))
def test_what_another_mesh_would_mend_is_said_of_a_built_in_shape(name: str) -> None:
    check = RESULT_CHECKS.working()[name]
    value = 1e3 if np.isfinite(check.high) else 0.0
    for clip in (CLIP, BUILT_IN):
        finding = check.finding(value, Evidence(clip, MASKS, deformed_mm=9.0))
        assert finding is not None
        assert finding.message.endswith(OWN_MESH_ADVICE) == (clip is BUILT_IN)


def test_one_problem_is_reported_once() -> None:
    both = [
        replace(RESULT_CHECKS.working()[name], measure=lambda _, value=value: value)
        for name, value in (("poor-mask-fit", 0.8), ("mask-misfit", 5.0))
    ]
    assert [finding.check for finding in run_checks(both, Evidence(CLIP, MASKS))[1]] == ["poor-mask-fit"]


@pytest.mark.parametrize("name", ["object-over-hand", "contact-gap"])
def test_the_distance_of_a_lifted_hand_is_weighed_and_refuses_nothing(name: str) -> None:
    """A hand lifted from 2D is centimetres off along the ray; results that are right have this fault."""
    clip, masks = small_clip()
    seen = replace(clip.hand, joints_2d=np.zeros((len(clip), 21, 2)), joints_2d_confidence=np.ones((len(clip), 21)))
    lifted = replace(clip, hand=seen, hand_scale=1.1)
    for given, serious in ((clip, True), (lifted, False)):
        finding = CHECKS[name].finding(100.0, Evidence(given, masks))
        assert finding is not None
        assert finding.serious == serious
    other = CHECKS["mask-fit"].finding(0.1, Evidence(lifted, masks))
    assert other is not None
    assert other.serious


CHECKS = {check.name: check for check in (*INPUT_CHECKS.values(), *RESULT_CHECKS.values(), JUMP_CHECK, FLOATING_CHECK)}


@pytest.mark.parametrize(
    ("check", "value", "words"),
    [
        ("mesh-open", 0.032, "the mesh is open, by 3.2 % of its surface (usual: at most 1 %);"),
        ("contact-gap", 22.31, "hand and object are 22.3 mm apart in half of the frames (usual: at most 15 mm);"),
        ("hand-side", -20.0, "the fingers bend by -20 degrees towards"),
        ("frame-order", 3.0, "would fit the hands 3 times better (usual: at most 2.5);"),
        ("mask-fit", 0.6, "the masks are met with a mean IOU of 0.6 (usual: at least 0.7);"),
        (
            "mesh-much-deformed",
            0.08,
            "was deformed by 7.8 mm, so its shape is an assumption (usual: at most 6 % of its diameter);",
        ),
        ("mesh-deformed", 0.03, "by 7.8 mm, so its shape is an assumption; the mesh is not the object's own"),
        ("jump", 0.5, "the object jumps by 50 % of its diameter more than"),
        ("floats", 20.0, "the object lies 20 mm above the support plane (usual: at most 15 mm);"),
        ("outlier-masks", 0.25, "1 of 4 masks contradicts the others and was left out: frame 0002; --given-masks"),
    ],
)
def test_values_are_said_as_people_count_them(check: str, value: float, words: str) -> None:
    given = Evidence(*small_clip(), iou=np.array([0.9, np.nan, 0.9, 0.9]), outliers=("0002",), deformed_mm=7.8)
    finding = CHECKS[check].finding(value, given)
    assert finding is not None
    assert words in finding.message
    assert finding.value == value


def test_what_is_found_reads_back_whatever_was_measured(tmp_path: Path) -> None:
    endless = replace(CHECKS["contact-gap"], measure=lambda given: np.inf)
    measured, findings = run_checks([endless], Evidence(*small_clip()))
    (written,) = json.loads(to_json(findings))
    assert read_findings(tmp_path, [written]) == findings
    assert np.isfinite(measured["contact-gap"])
