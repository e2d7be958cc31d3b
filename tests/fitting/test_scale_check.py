"""Laws of the size that an object would rather have: none but the true one gains, and units do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.stages.confidence import scale_check
from getagrip.geometry.mesh import Mesh
from helpers.scenes import SHORT, scene


def rather(clip: Clip, masks: Masks, method: str = "soft-hinge") -> tuple[float, float]:
    problem = prepare_problem(with_masks(clip, masks), Options(method=method, inits=10))
    return scale_check(problem, METHODS[method].fit(problem, lambda _: None))


def resized(clip: Clip, by: float) -> Clip:
    return replace(clip, mesh=Mesh(by * clip.mesh.vertices, clip.mesh.faces), truth=None)


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof", "dynamic"])
@pytest.mark.slow
def test_the_true_size_is_the_best(method: str) -> None:
    factor, gain = rather(*scene("bottle", 1, SHORT), method)
    assert factor == pytest.approx(1.0, abs=0.02)
    assert 0.0 <= gain < 0.15


@pytest.mark.parametrize("by", [0.9, 1.1])
@pytest.mark.slow
def test_a_size_that_is_not_the_objects_is_told(by: float) -> None:
    clip, masks = scene("bottle", 1, SHORT)
    factor, gain = rather(resized(clip, by), masks)
    assert factor * by == pytest.approx(1.0, abs=0.04)
    assert gain > 0.3


def test_nothing_is_known_where_the_size_was_free_or_the_method_has_no_motion() -> None:
    clip, masks = scene("bottle", 1, SHORT)
    assert np.isnan(rather(replace(clip, scale="free"), masks)).all()
    assert np.isnan(rather(clip, masks, "single-frame")).all()
