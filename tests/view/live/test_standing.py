"""What stands still does not move, and the middle frame looks the same whatever stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import World
from getagrip.geometry import se3
from getagrip.view.live import standing
from getagrip.view.live.column import Column
from helpers.two_candidates import column, two_candidates


def in_world(up: np.ndarray | None = None) -> Column:
    """The column with a camera that moves and is tilted."""
    T = len(column().view.clip)
    turn = np.linspace(0.0, 0.4, T)[:, None] * np.array([0.3, 1.0, 0.2])
    return _with(World(se3.rigid(se3.exp_so3(turn), np.linspace(0.0, 0.1, T)[:, None] * np.ones(3)), up))


def nowhere() -> Column:
    """The column with a camera of which nothing is known."""
    return _with(None)


def _with(world: World | None) -> Column:
    it = column()
    return Column(it.name, replace(it.view, clip=replace(it.view.clip, world=world)))


@pytest.mark.parametrize("still", ["hand", "object", "camera", "world"])
def test_what_stands_still_does_not_move(still: str) -> None:
    it = in_world()
    T_scene_cam = standing.T_scene_cam(it, still)
    posed = T_scene_cam @ standing.FRAMES[still](it)
    assert np.allclose(posed, posed[0], atol=1e-12)
    assert np.allclose(T_scene_cam[len(it.view.clip) // 2], np.eye(4), atol=1e-12)


def test_only_what_all_columns_know_may_stand_still() -> None:
    _, clip, masks = two_candidates()
    alone = Column.of_clip(replace(clip, truth=None, world=None), masks)
    assert standing.choices([nowhere()]) == ("hand", "object", "camera")
    assert standing.choices([in_world()]) == ("hand", "object", "camera", "world")
    assert standing.choices([nowhere(), in_world()]) == ("hand", "object", "camera")
    assert standing.choices([alone]) == ("hand", "camera")


def test_upwards_is_away_from_the_ground_where_that_is_known() -> None:
    ground = np.array([0.0, 0.6, 0.8])
    it = in_world(ground)
    world = it.view.clip.world
    assert world is not None
    assert np.allclose(world.T_world_cam[len(it.view.clip) // 2, :3, :3] @ standing.up(it), ground)
    assert np.allclose(standing.up(in_world()), [0.0, -1.0, 0.0])
    assert np.allclose(standing.up(nowhere()), [0.0, -1.0, 0.0])
