"""Paths of followed poses: distinct, the cheapest of each start kept, and true ones stay true."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import Hypotheses, TimelineInputs
from getagrip.timelines.tracking import N_PATHS, _select_distinct_paths, track_hypotheses
from helpers.scenes import timeline


def test_the_cheapest_distinct_paths_of_each_start_are_kept() -> None:
    rng = np.random.default_rng(0)
    spots, cost, start = rng.uniform(size=(60, 12)), rng.uniform(size=60), rng.integers(3, size=60)
    spots[1], start[1], cost[1] = spots[0] + 1e-4, start[0], cost[0] + 1.0  # a copy
    kept = _select_distinct_paths(spots, cost, start, 5, 0.5)
    assert np.all(np.diff(cost[kept]) > 0.0)
    assert 1 not in kept
    for one in range(3):
        mine, every = kept[start[kept] == one], np.flatnonzero(start == one)
        assert mine[0] == every[np.argmin(cost[every])]
        apart = np.linalg.norm(spots[mine][:, None] - spots[mine], axis=-1)
        assert apart[~np.eye(len(mine), dtype=bool)].min() > 0.5
        assert len(mine) <= 5


@pytest.mark.slow
@pytest.mark.parametrize("back", [False, True])
def test_the_best_path_is_the_true_one(back: bool) -> None:
    clip, masks = timeline()
    footage = TimelineInputs.of(repair_input(with_masks(clip, masks), Options(inits=20)))
    assert clip.truth is not None
    T = footage.T_world_cam @ clip.truth.T_cam_obj
    begin, rows = (7, np.arange(6, 2, -1)) if back else (4, np.arange(5, 10))
    centre = se3.transform(T[begin], clip.mesh.centre[None])
    away = centre + 0.4 * clip.mesh.diameter  # another start, which is wrong
    start = Hypotheses(
        T[[begin, begin], None, :3, :3], np.stack([centre, away]), np.ones(2), np.array([0.0, 1.0])
    )  # fmt: skip
    paths = track_hypotheses(footage, begin, rows, start)
    assert paths.start[0] == 0
    assert {*paths.start} == {0, 1}
    assert np.bincount(paths.start).max() <= N_PATHS
    off = se3.transform(paths.found.T_world_obj(clip.mesh.centre)[0], clip.mesh.vertices[None])
    off = off - se3.transform(T[rows], clip.mesh.vertices[None])
    assert np.linalg.norm(off, axis=-1).mean(axis=1).max() < 0.07 * clip.mesh.diameter
