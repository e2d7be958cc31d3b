"""Laws of the iteration limit: how far it is from the end is measured, and a fit that is near it has not failed."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import FrameSolutions, _final_status
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.geometry import se3
from getagrip.reconstruct import unconverged_motion
from getagrip.result import Status
from helpers.scenes import SHORT, scene


@pytest.fixture(scope="module")
def fit() -> tuple[Problem, MethodResult]:
    problem = prepare_problem(with_masks(*scene("mug", 1, SHORT)), Options(inits=10))
    found = METHODS["soft-hinge"].fit(problem, lambda _: None)
    return problem.as_found(found), found


def test_a_fit_that_was_stopped_early_would_go_far(fit: tuple[Problem, MethodResult]) -> None:
    problem, found = fit
    assert found.motion is not None
    away = found.motion.rotated(se3.exp_so3(np.array([[0.0, 0.1, 0.0]])))
    stopped = replace(found, status=Status.LIMIT, motion=away, poses=away.poses())
    left = unconverged_motion(problem, replace(found, status=Status.LIMIT))
    assert 0.0 <= left < 2e-3 < unconverged_motion(problem, stopped)


@pytest.mark.parametrize("status", [Status.CONVERGED, Status.STUCK])
def test_nothing_is_cut_off_where_the_limit_was_not_reached(status: Status, fit: tuple[Problem, MethodResult]) -> None:
    problem, found = fit
    assert unconverged_motion(problem, replace(found, status=status)) == 0.0


def test_a_method_without_a_motion_cannot_go_on(fit: tuple[Problem, MethodResult]) -> None:
    problem, found = fit
    assert np.isnan(unconverged_motion(problem, replace(found, status=Status.LIMIT, motion=None)))


@pytest.mark.parametrize(
    ("left", "status", "said"),
    [
        (0.0, Status.CONVERGED, "converged to 0.1 mm"),
        (1e-4, Status.CONVERGED, "converged to 0.1 mm"),
        (1.9e-3, Status.LIMIT, "converged to 1.9 mm"),
        (4e-3, Status.LIMIT, "stopped at the iteration limit: further iterations would move the object by 4.0 mm"),
        (float("nan"), Status.LIMIT, "stopped at the iteration limit"),
    ],
)
def test_only_a_fit_far_from_its_end_is_said_to_have_stopped(left: float, status: Status, said: str) -> None:
    track = type("Track", (), {"iou": np.ones(3), "outliers": ()})()
    answer = cast(
        "FrameSolutions", type("Of", (), {"track": track, "status": Status.LIMIT, "cut_off": left, "scale": [1.0]})()
    )
    ended, message = _final_status(answer, "", diameter=0.1)
    assert ended is status
    assert message.startswith(said)
    assert ("--thorough" in message) == message.startswith("stopped")
