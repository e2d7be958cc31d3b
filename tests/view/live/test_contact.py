"""Contact on both surfaces agrees with the distances of the metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.metrics.contact import contact_distances
from getagrip.metrics.pose import ObjectTrack
from getagrip.view.gap import FACES
from getagrip.view.live.column import Column
from getagrip.view.live.contact import REACH, Surfaces
from getagrip.view.live.patch import NOTHING
from helpers.two_candidates import column


@pytest.mark.slow
def test_distances_are_those_of_the_metrics() -> None:
    it = column()
    clip, result = it.view.clip, it.view.result
    (known,) = contact_distances(
        clip.mesh, [ObjectTrack(result.T_hand_obj, result.scale)], clip.hand.vertices, clip.hand.faces, REACH
    )
    touch = Surfaces(it).touch(2)
    assert len(clip.mesh.faces) < FACES
    assert np.allclose(touch.hand, np.minimum(known.hand[2], REACH), atol=1e-9)
    assert np.allclose(touch.object[: len(clip.mesh.vertices)], np.minimum(known.object[2], REACH), atol=1e-9)


@pytest.mark.slow
def test_contact_is_marked_where_the_two_meet() -> None:
    it = column()
    surfaces, T_hand_obj = Surfaces(it), it.view.result.T_hand_obj[1]
    on_object, _ = surfaces.on_object(1, 0.005)
    on_hand, _ = surfaces.on_hand(1, 0.005)
    there = se3.transform(T_hand_obj, on_object)
    apart = np.linalg.norm(there[:, None] - on_hand, axis=2)
    assert apart.min(axis=0).max() < 0.02
    assert len(surfaces.on_hand(1, 0.010)[0]) > len(on_hand)


def test_bodies_that_are_far_apart_have_no_contact() -> None:
    it = column()
    away = se3.rigid(None, np.array([0.0, 0.0, 1.0])) @ it.candidates.T_hand_obj[0]
    far = Surfaces(Column("far", replace(it.view, result=replace(it.view.result, T_hand_obj=away))))
    assert far.on_object(0, 0.02) is NOTHING
    assert far.on_hand(0, 0.02) is NOTHING
