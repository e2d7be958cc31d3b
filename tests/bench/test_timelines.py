"""Scores of timelines: the truth is right everywhere, and every variant answers every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.bench.sequences.timelines import segment_jumps, segment_scores
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.metrics.symmetry import find_symmetries
from getagrip.timelines.variants import TIMELINE_VARIANTS, reconstruct_variant
from helpers.scenes import timeline


@pytest.mark.slow
def test_the_truth_is_right_and_does_not_jump() -> None:
    clip, _ = timeline()
    assert clip.truth is not None
    true = clip.truth.T_cam_obj
    scores = segment_scores(clip, find_symmetries(clip.mesh), true, clip.truth.T_cam_hand)
    assert [(s.kind, s.right, s.right_sym) for s in scores] == [
        ("static", True, True), ("between", True, True), ("grasp", True, True),
    ]  # fmt: skip
    assert [s.sca is None for s in scores] == [True, True, False]
    np.testing.assert_allclose(segment_jumps(clip, true), 0.0, atol=1e-9)
    shifted = true.copy()
    shifted[clip.segments[2].first :, 0, 3] += 0.05
    assert segment_jumps(clip, shifted) == pytest.approx([0.0, 0.05], abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("variant", TIMELINE_VARIANTS)
def test_every_variant_answers_every_frame(variant: str) -> None:
    clip, masks = timeline()
    assert clip.world is not None
    motion = reconstruct_variant(variant, replace(clip, truth=None), masks, Options(inits=4))
    assert se3.is_rigid(motion.T_cam_obj).all()
    assert len(motion.kind) == len(clip)
    lying = clip.segments[0].rows
    still = clip.world.T_world_cam[lying] @ motion.T_cam_obj[lying]
    np.testing.assert_allclose(still, np.tile(still[:1], (len(lying), 1, 1)), atol=1e-9)
