"""Laws of a lifted hand's size: it follows from the object's, and one camera cannot tell a scene from a larger one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.inputs.simulated_evidence import SimulatedDepth
from getagrip.clip import Clip, Segment, with_masks
from getagrip.clip.depth import DEPTH_KEY, Depth
from getagrip.fitting.hand.joint_hand_object import (
    HAND_SIZE_SIGMA,
    STATED_SIZE_SIGMA,
    restore_object_size,
    with_hand_size,
)
from getagrip.fitting.methods.all_frames import search_of
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.solver.search import DEFAULT_SCHEDULE, THOROUGH_SCHEDULE
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.provenance import assumed, measured
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction, read_result, write_result
from helpers.scenes import SMALL, scene, scores

LIFTED = {"hands_scale": assumed("a mean hand's")}


def with_larger_hand(clip: Clip, by: float) -> Clip:
    """A hand that looks the same, larger and farther away, as it is lifted from 2D if a mean hand is larger."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] *= by
    return replace(clip, hand=replace(clip.hand.scaled(by), T_cam_hand=T))


def test_beside_a_lifted_hand_the_search_is_long() -> None:
    clip, masks = scene("mug", 1, SMALL)
    for known, schedule in ((LIFTED, THOROUGH_SCHEDULE), ({}, DEFAULT_SCHEDULE)):
        problem = prepare_problem(with_masks(replace(clip, provenance=known), masks), Options())
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
    assert with_hand_size(lifted, Options()).size_sigmas == (HAND_SIZE_SIGMA, 0.0)
    whole = (Segment("grasp", 0, len(clip) - 1, clip.side),)
    others = [
        clip, replace(clip, provenance={"hands_scale": measured("by a scanner")}), replace(lifted, scale="free"),
        replace(lifted, segments=whole),
    ]  # fmt: skip
    for other in others:
        assert with_hand_size(other, Options()) is other
    assert with_hand_size(lifted, Options(method="paper")) is lifted


@pytest.mark.parametrize("by", [0.8, 1.25])
def test_a_sensor_shows_how_large_a_lifted_hand_is(by: float) -> None:
    clip, masks = scene("mug", 1, SMALL)
    seen, _ = SimulatedDepth("realsense")(clip, masks, 0)
    lifted = with_masks(replace(with_larger_hand(seen, by), provenance=LIFTED, scale="free"), masks)
    sized = with_hand_size(lifted, Options())
    assert sized.hand_scale == pytest.approx(1.0 / by, rel=0.02)
    again = clip.with_hand_at(sized.hand.T_cam_hand, scale=by * sized.hand_scale)
    np.testing.assert_array_almost_equal(sized.hand.vertices, again.hand.vertices)
    assert sized.size_sigmas is None
    known = with_hand_size(replace(lifted, scale="known"), Options())
    assert (known.scale, known.hand_scale) == ("known", sized.hand_scale)
    depth = lifted.evidence[DEPTH_KEY]
    assert isinstance(depth, Depth)
    for z in (np.where(np.arange(depth.z.size).reshape(depth.z.shape) % 97 == 0, depth.z, 0.0), 1e3 * depth.z):
        few = replace(
            lifted, evidence={**lifted.evidence, DEPTH_KEY: replace(depth, z=z)}
        )  # three samples; millimetres
        assert with_hand_size(few, Options()).hand_scale == 1.0
    for level, scale in (("realsense", "clip"), ("mono", "metric")):  # of no metre, of a network
        other = SimulatedDepth(level)(lifted, masks, 0)[0].evidence[DEPTH_KEY]
        assert isinstance(other, Depth)
        other = replace(other, source=replace(other.source, scale=scale))
        assert (
            with_hand_size(replace(lifted, evidence={**lifted.evidence, DEPTH_KEY: other}), Options()).hand_scale == 1.0
        )


@pytest.mark.slow
def test_beside_a_sensor_hand_and_object_have_their_own_sizes() -> None:
    clip, masks = scene("mug", 1, SMALL)
    seen, _ = SimulatedDepth("realsense")(clip, masks, 0)
    wrong = with_larger_hand(seen, 1.2)
    found = reconstruct(replace(wrong, provenance=LIFTED, scale="free"), masks, Options())
    assert found.hand_scale == pytest.approx(1.0 / 1.2, rel=0.02)
    assert found.scale == pytest.approx(1.0, rel=0.03)
    assert "hands_scale" not in found.assumptions
    assert scores(found, wrong, masks)["add_sym_mm"] < 5.0


@pytest.mark.slow
def test_a_scaled_scene_looks_the_same() -> None:
    clip, masks = scene("mug", 1, SMALL)
    beside = with_hand_size(replace(clip, provenance=LIFTED), Options())
    found = reconstruct(replace(beside, size_sigmas=None), masks, Options())
    scaled = restore_object_size(found, beside)

    def posed(result: Reconstruction) -> tuple[np.ndarray, np.ndarray]:
        hand = clip.with_hand_at(result.T_cam_hand, scale=result.hand_scale).hand
        object_ = se3.transform(hand.T_cam_hand @ result.T_hand_obj, result.scale * clip.mesh.vertices[None])
        return se3.transform(hand.T_cam_hand, hand.vertices), object_

    for after, before in zip(posed(scaled), posed(found), strict=True):
        np.testing.assert_allclose(after, scaled.hand_scale * before, atol=1e-9)


@pytest.mark.parametrize("lifted", [False, True])
def test_the_stated_size_of_a_guessed_shape_is_free_beside_any_hand(lifted: bool) -> None:
    clip, _ = scene("mug", 1, SMALL)
    guessed = replace(clip, provenance={"mesh": assumed("a built-in mug")} | (LIFTED if lifted else {}))
    beside = with_hand_size(guessed, Options())
    assert beside.scale == "free"
    assert beside.size_sigmas == (HAND_SIZE_SIGMA if lifted else 0.0, STATED_SIZE_SIGMA)
    assert beside.hand_size_share == pytest.approx(0.5 if lifted else 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("by", [0.9, 1.1])
def test_a_measured_hand_overrules_the_size_stated_for_a_guessed_shape(by: float) -> None:
    clip, masks = scene("mug", 1, SMALL)
    wrong = replace(clip, mesh=Mesh(by * clip.mesh.vertices, clip.mesh.faces), provenance={"mesh": assumed("a guess")})
    found = reconstruct(wrong, masks, Options())
    assert found.hand_scale == 1.0
    assert found.scale == pytest.approx(1.0 / by, rel=0.03)
    assert "scale" in found.assumptions


@pytest.mark.slow
def test_two_uncertain_sizes_share_their_disagreement() -> None:
    clip, masks = scene("mug", 1, SMALL)
    farther = replace(with_larger_hand(clip, 1.2), provenance=LIFTED | {"mesh": assumed("a guess")})
    found = reconstruct(farther, masks, Options())
    assert found.hand_scale == pytest.approx(1.2**-0.5, rel=0.03)
    assert found.scale == pytest.approx(1.2**0.5, rel=0.03)
