"""What the 3D view of a page holds of two hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.clip import OtherHand
from getagrip.geometry import se3
from getagrip.report.pages import scene_data
from getagrip.report.pictures.contact_colours import subdivide_object, surface_gap
from getagrip.report.pictures.result_view import View
from helpers.scenes import egg_and_mug, perfect


def test_what_the_other_hand_touches_is_touched() -> None:
    """A clip whose own hand is far away, and whose other hand holds the object, as far as it is known."""
    clip, _ = egg_and_mug()
    result, known = perfect(clip), np.array([0, 2])
    aside = se3.rigid(t=np.array([-0.5, 0.0, 0.0])) @ clip.hand.T_cam_hand
    given = replace(
        clip, side="left", hand=replace(clip.hand, T_cam_hand=aside), truth=None,
        other_hand=OtherHand.at(clip.hand.take(known), known, len(clip)),
    )  # fmt: skip
    moved = replace(result, T_hand_obj=se3.inverse(aside) @ clip.hand.T_cam_hand @ result.T_hand_obj)
    one, both = View.of(result, clip, None), View.of(moved, given, None)
    gaps = surface_gap(both)
    np.testing.assert_allclose(gaps[known], surface_gap(one)[known], atol=1e-9)
    assert gaps[[1, 3, 4]].min() > 0.1
    surface = subdivide_object(one)
    alone, found = scene_data.per_frame_arrays(one, surface), scene_data.per_frame_arrays(both, surface)
    assert alone["hand_near"][known].max() == 255
    for name, of in (("object_near", "object_near"), ("other_hand_near", "hand_near")):
        np.testing.assert_array_equal(found[name][known], alone[of][known])
        assert found[name][[1, 3, 4]].max() == 0
    assert found["hand_near"].max() == 0
    assert scene_data.constant_arrays(both, surface)["other_hand_known"].tolist() == [1, 0, 1, 0, 0]
