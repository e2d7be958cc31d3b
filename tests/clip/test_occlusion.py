"""What a hand hides, where no mask says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.clip import Masks, with_masks
from getagrip.clip.masks import occluded_by_hand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from helpers.clips import small_clip


def test_what_is_hidden_is_the_hand_but_for_the_object() -> None:
    clip, masks = small_clip(3)
    hidden = occluded_by_hand(clip, masks)
    for n, vertices in enumerate(se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)):
        hand = depth_and_face(vertices, clip.hand.faces, clip.K[n], clip.size)[1] >= 0
        np.testing.assert_array_equal(hidden.ignore[n] | (hand & masks.object[n]), hand)
    assert hidden.ignore.any()
    assert not (hidden.ignore & masks.object).any()
    assert hidden.object is masks.object


def test_the_hand_is_drawn_only_where_no_mask_says_what_is_hidden() -> None:
    clip, masks = small_clip(3)
    silent = Masks(masks.object, np.zeros_like(masks.ignore))
    assert any("rendered hand" in note for note in prepare_problem(with_masks(clip, silent), Options()).notes)
    marked = Masks(masks.object, silent.ignore.copy())
    marked.ignore[0, 0, 0] = True
    for given, options in ((marked, Options()), (silent, replace(Options(), occlusion=False))):
        problem = prepare_problem(with_masks(clip, given), options)
        assert not any("rendered hand" in note for note in problem.notes)
        np.testing.assert_array_equal(problem.masks.ignore, given.ignore)
