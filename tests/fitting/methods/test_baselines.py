"""The baselines on synthetic clips: what they recover, what a result holds, what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from getagrip.clip import Masks
from getagrip.errors import GetagripError
from getagrip.fitting.energy import Energy
from getagrip.fitting.methods import all_frames
from getagrip.fitting.objective import energy_of
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip
from helpers.scenes import SHORT, SMALL, scene, scores

BASELINES = ("single-frame", "homan", "contact-consistency")


@cache
def found(method: Any, category: str, seed: int, options: SceneOptions = SMALL) -> Reconstruction:
    return reconstruct(*scene(category, seed, options), Options(method=method, inits=16))


@pytest.mark.parametrize("method", BASELINES)
@pytest.mark.slow
def test_a_kettle_is_recovered(method: str) -> None:
    metrics = scores(found(method, "kettle", 1), *scene("kettle", 1))
    assert metrics["add_sym_success"] == 1.0
    assert metrics["iou"] > 0.9


@pytest.mark.parametrize("method", BASELINES)
@pytest.mark.slow
def test_an_unknown_scale_is_recovered(method: str) -> None:
    options = replace(SMALL, scale="free")
    metrics = scores(found(method, "kettle", 1, options), *scene("kettle", 1, options))
    assert abs(metrics["scale_error"]) < 0.15
    assert metrics["iou"] > 0.85


@pytest.mark.parametrize("method", BASELINES)
@pytest.mark.slow
def test_what_a_result_holds(method: str) -> None:
    result = found(method, "kettle", 1)
    assert result.method == method
    assert result.options["method"] == method
    assert result.frames == scene("kettle", 1)[0].frames
    assert se3.is_rigid(result.T_hand_obj).all()
    assert result.axis is None
    np.testing.assert_array_equal(result.candidates.T_hand_obj[0], result.T_hand_obj)
    assert (np.diff(result.candidates.energy) >= 0.0).all()
    assert sum(v for k, v in result.energy.items() if k != "total") == pytest.approx(result.energy["total"])


@pytest.mark.slow
def test_a_single_frame_knows_nothing_of_the_others() -> None:
    clip, masks = scene("spoon", 1, SHORT)
    back = np.arange(len(clip))[::-1]
    options = Options(method="single-frame", inits=12)
    forth = reconstruct(clip, masks, options)
    backward = replace(clip.take(back), times=clip.times)
    reverse = reconstruct(backward, Masks(masks.object[back], masks.ignore[back]), options)
    np.testing.assert_allclose(reverse.T_hand_obj[back], forth.T_hand_obj, atol=1e-6)


@pytest.mark.slow
def test_consistency_holds_the_object_stiller_than_dynamic() -> None:
    def spread(result: Reconstruction) -> float:
        held = se3.transform(result.T_hand_obj, scene("mug", 2)[0].mesh.vertices)
        return float(np.linalg.norm(held - held.mean(axis=0), axis=-1).mean())

    assert spread(found("contact-consistency", "mug", 2)) < spread(found("dynamic", "mug", 2))


@pytest.mark.parametrize("method", ["static", "one-dof", "dynamic", "soft-hinge", "contact-consistency"])
@pytest.mark.slow
def test_contact_weighs_more_where_no_other_term_ties_the_object_to_the_hand(
    method: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = {}

    def asks(problem: Problem, push: float, pull: float) -> Energy:
        asked.update(push=push, pull=pull)
        return energy_of(problem, push, pull)

    monkeypatch.setattr(all_frames, "energy_of", asks)
    options = Options(method=method, inits=4)
    reconstruct(*small_clip(), options)
    heavy = 1.0 if method in ("soft-hinge", "contact-consistency") else 4.0
    assert asked == {"push": heavy * options.push, "pull": heavy * options.pull}


@pytest.mark.parametrize("method", BASELINES)
def test_a_hand_behind_the_camera_is_an_error(method: Any) -> None:
    clip, masks = small_clip()
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    hand = replace(clip.hand, T_cam_hand=mirror @ clip.hand.T_cam_hand @ mirror)
    with pytest.raises(GetagripError, match="behind the camera"):
        reconstruct(replace(clip, hand=hand, truth=None), masks, Options(method=method, inits=4))
