"""Laws of a lifted hand's size: it follows from the object's, and one camera cannot tell a scene from a larger one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Segment, with_masks
from getagrip.fitting.hand_size import at_object_size, beside_hand
from getagrip.fitting.methods.all_frames import search_of
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare
from getagrip.fitting.schedule import THOROUGH, USUAL
from getagrip.geometry import se3
from getagrip.provenance import assumed, measured
from getagrip.result import Reconstruction, read_result, write_result
from getagrip.timelines.reconstruct import reconstruct
from helpers.scenes import SMALL, scene, scores

LIFTED = {"hands_scale": assumed("a mean hand's")}


def with_larger_hand(clip: Clip, by: float) -> Clip:
    """A hand that looks the same, larger and farther away, as it is lifted from 2D if a mean hand is larger."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] *= by
    return replace(clip, hand=replace(clip.hand.scaled(by), T_cam_hand=T))


def test_beside_a_lifted_hand_the_search_is_long() -> None:
    clip, masks = scene("mug", 1, SMALL)
    for known, schedule in ((LIFTED, THOROUGH), ({}, USUAL)):
        problem = prepare(with_masks(replace(clip, provenance=known), masks), Options())
        assert search_of(problem, lambda stage: None).schedule == schedule


@pytest.mark.slow
@pytest.mark.parametrize("by", [0.85, 1.2])
def test_a_hand_of_another_size_is_scaled_to_the_object(by: float, tmp_path: Path) -> None:
    clip, masks = scene("mug", 1, SMALL)
    wrong = with_larger_hand(clip, by)
    found = reconstruct(replace(wrong, provenance=LIFTED), masks, Options())
    assert found.scale == 1.0
    assert found.hand_scale == pytest.approx(1.0 / by, rel=0.03)
    assert "hands_scale" in found.assumptions
    assert "scale" not in found.assumptions
    assert scores(found, wrong, masks)["add_sym_cam_mm"] < 15.0
    given = reconstruct(wrong, masks, Options())  # a measured hand is believed
    assert given.hand_scale == 1.0
    assert scores(given, wrong, masks)["add_sym_mm"] > 2.0 * scores(found, wrong, masks)["add_sym_mm"]
    write_result(found, tmp_path / "result", "0" * 64)
    again, _ = read_result(tmp_path / "result")
    assert again.hand_scale == found.hand_scale


def test_only_hands_of_assumed_size_and_objects_of_known_size_are_scaled() -> None:
    clip, _ = scene("mug", 1, SMALL)
    lifted = replace(clip, provenance=LIFTED)
    assert beside_hand(lifted, Options()).size_beside_hand
    whole = (Segment("grasp", 0, len(clip) - 1, clip.side),)
    others = [
        clip, replace(clip, provenance={"hands_scale": measured("by a scanner")}), replace(lifted, scale="free"),
        replace(lifted, segments=whole),
    ]  # fmt: skip
    for other in others:
        assert beside_hand(other, Options()) is other
    assert beside_hand(lifted, Options(method="paper")) is lifted


@pytest.mark.slow
def test_what_is_scaled_looks_the_same() -> None:
    clip, masks = scene("mug", 1, SMALL)
    beside = beside_hand(replace(clip, provenance=LIFTED), Options())
    found = reconstruct(replace(beside, size_beside_hand=False), masks, Options())
    scaled = at_object_size(found, beside)

    def posed(result: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
        hand = clip.with_hand_at(result.T_cam_hand, scale=result.hand_scale).hand
        object_ = se3.transform(hand.T_cam_hand @ result.T_hand_obj, result.scale * clip.mesh.vertices[None])
        return se3.transform(hand.T_cam_hand, hand.vertices), object_

    for after, before in zip(posed(scaled), posed(found), strict=True):
        np.testing.assert_allclose(after, scaled.hand_scale * before, atol=1e-9)
