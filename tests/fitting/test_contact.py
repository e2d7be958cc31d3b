"""Contact vertices of a hand."""

from __future__ import annotations

import numpy as np

from getagrip.fitting.energy.contact import HandContacts, farthest_point_sampling
from getagrip.geometry import se3
from helpers.clips import small_clip


def test_contact_vertices_are_the_regions_fingertips_first() -> None:
    hand = small_clip()[0].hand
    contact = HandContacts.of(hand)
    assert contact.position.shape == (3, 12, 3)
    np.testing.assert_array_equal(contact.region, [0, 2, 4, 6, 8, 10])
    thumb = se3.transform(hand.T_cam_hand, hand.vertices[:, hand.regions["thumb"]])
    np.testing.assert_allclose(contact.position[:, :2], thumb)
    assert HandContacts.of(hand, per_region=1).position.shape == (3, 6, 3)
    np.testing.assert_array_equal(contact.take(np.array([2])).position, contact.position[[2]])


def test_spread_points_cover_a_line() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros((101, 2))])
    np.testing.assert_array_equal(farthest_point_sampling(line, 3), [0, 50, 100])
    np.testing.assert_array_equal(farthest_point_sampling(line[:2], 3), [0, 1])
