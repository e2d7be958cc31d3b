"""Time goes on as in the footage, and comes round."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.view.live.player import LONGEST, REST, Player

TIME = np.array([0.0, 0.1, 0.2, 0.5, 30.0])


def test_frames_are_shown_as_long_as_in_the_footage() -> None:
    player = Player(TIME)
    shown = []
    for _ in range(6):
        shown.append((player.frame, round(player.duration, 6)))
        assert player.late(player.duration) == pytest.approx(0.0)
    assert shown == [(0, 0.1), (1, 0.1), (2, 0.3), (3, LONGEST), (4, REST), (0, 0.1)]


def test_speed_shortens_all_of_them() -> None:
    assert Player(TIME, frame=2, speed=2.0).duration == pytest.approx(0.15)


def test_a_slow_page_skips_frames_but_always_shows_the_first() -> None:
    player = Player(TIME)
    assert player.late(0.25) == pytest.approx(0.05)
    assert player.frame == 2
    assert player.late(1e6) == 0.0
    assert player.frame == 0


def test_before_the_first_frame_is_the_last() -> None:
    player = Player(TIME)
    player.go(-1)
    assert player.frame == 4
    player.go(5)
    assert player.frame == 0


def test_a_single_frame_rests() -> None:
    player = Player(np.zeros(1))
    assert player.late(10.0) == 0.0
    assert player.duration == REST
