"""The gap is the smallest signed distance of hand and object, whichever of them has the vertices that show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.report.pictures.contact_colours import GAP_SEARCH_DISTANCE_M, surface_gap
from getagrip.report.pictures.result_view import View
from helpers.clips import box
from helpers.scenes import FRAMES, egg_and_mug, perfect

RADIUS = 0.04


def ball_and(mesh: Mesh, x: float) -> View:
    """A hand that is a ball, and a body whose frame is so far from the ball's middle [m]."""
    clip, _ = egg_and_mug()
    ball = replace(clip.hand, vertices=clip.hand.vertices / [1.5, 1.0, 0.7])
    T = np.tile(se3.rigid(se3.exp_so3(np.array([0.0, 0.0, np.pi / 4.0])), np.array([x, 0.0, 0.0])), (FRAMES, 1, 1))
    alone = replace(clip, hand=ball, mesh=mesh, truth=None)
    return View.of(replace(perfect(clip), T_hand_obj=T), alone, None)


@pytest.mark.parametrize("apart", [-0.01, 0.01, 2.0 * GAP_SEARCH_DISTANCE_M])
def test_an_edge_of_a_box_is_as_far_from_a_ball_as_it_is(apart: float) -> None:
    """No corner of the box is near the ball, and no vertex of the ball as deep in the box as its edge."""
    half = 0.1
    view = ball_and(box(2.0 * half, 2.0 * half, 2.0 * half), RADIUS + apart + np.sqrt(2.0) * half)
    np.testing.assert_allclose(surface_gap(view), apart, atol=1.5e-3)
