"""The table of methods: an unknown name is refused, a method of one's own counts, results have an axis as it says."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.fitting.energy import Energy
from getagrip.fitting.energy.homan_terms import InteractionTerm
from getagrip.fitting.methods import METHODS, Method, OnStage, paper
from getagrip.fitting.methods.all_frames import soft_hinge, static
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.reconstruct import reconstruct
from helpers.clips import small_clip


def test_an_unknown_method_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="unknown method 'hinge'; choose from one-dof, soft-hinge"):
        Options(method="hinge")


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.slow
def test_results_have_an_axis_where_the_table_says_so(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 5)
    result = reconstruct(*small_clip(), Options(method=name, inits=4))
    assert (result.axis is not None) == METHODS[name].has_axis
    assert result.method == name


@pytest.mark.slow
def test_a_users_method_is_used_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    stages = []

    def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
        return static(problem, lambda name: (stages.append(name), on_stage(name))[1])

    monkeypatch.setitem(METHODS, "own", Method("Own", fit))
    own = reconstruct(*small_clip(), Options(method="own", inits=4))
    usual = reconstruct(*small_clip(), Options(method="static", inits=4))
    np.testing.assert_array_equal(own.T_hand_obj, usual.T_hand_obj)
    assert stages == ["coarse", "middle", "fine", "finest"]


@pytest.mark.slow
def test_a_users_term_counts_in_all_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    """The object is drawn to a place, the more the heavier the term."""
    clip, masks = small_clip()
    place = clip.hand.T_cam_hand[:, :3, 3] + [0.0, 0.03, 0.0]

    def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
        def more(problem: Problem) -> Energy:
            places = place[clip.index_of(problem.clip.frames)]
            return lambda level, frames: [InteractionTerm(places[frames], 1e9)]

        return soft_hinge(problem, on_stage, more)

    monkeypatch.setitem(METHODS, "drawn", Method("Drawn", fit, has_axis=True))
    result = reconstruct(clip, masks, Options(method="drawn", inits=4, hands="as-given"))
    T_cam_obj = clip.hand.T_cam_hand @ result.T_hand_obj
    centre = T_cam_obj[:, :3, :3] @ clip.mesh.centre + T_cam_obj[:, :3, 3]
    np.testing.assert_allclose(centre, place, atol=2e-3)
    assert result.energy["interaction"] > 0.0
