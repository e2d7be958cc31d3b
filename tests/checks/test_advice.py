"""Findings say what to do: they ask nothing, and of a built-in shape they say that it is a guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.checks import Evidence, input_checks, result_checks, run_checks
from getagrip.checks.check import OWN_MESH_ADVICE
from getagrip.checks.table import RESULT_CHECKS
from getagrip.provenance import assumed
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
