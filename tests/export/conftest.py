"""A scene to export."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import OtherHand
from getagrip.export import Scene
from helpers.results import result_and_clip


@pytest.fixture
def scene() -> Scene:
    return Scene.of(*result_and_clip())


@pytest.fixture
def both(scene: Scene) -> Scene:
    """The same with the other hand beside the first one; it is not known in the second of the three frames."""
    hand, rows = result_and_clip()[1].hand.take(np.arange(2, 5)), np.array([0, 2])
    T = hand.T_cam_hand.copy()
    T[:, 0, 3] += 0.2
    mirror = np.array([-1.1, 1.1, 1.1])
    track = replace(hand, vertices=mirror * hand.vertices, faces=hand.faces[:, ::-1], T_cam_hand=T)
    return replace(scene, other_hand=OtherHand.at(track.take(rows), rows, 3))
