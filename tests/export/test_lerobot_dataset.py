"""Many results as one dataset of LeRobot: rows, records and totals agree, and it can be continued after any end."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.export import Scene
from getagrip.export.lerobot import statistics
from getagrip.export.lerobot_dataset import Dataset
from helpers.needs import needs

pytestmark = needs("pyarrow", "lerobot")


def columns(folder: Path) -> dict[str, np.ndarray]:
    """The rows of all episodes."""
    from pyarrow import parquet

    tables = [parquet.read_table(path) for path in sorted(folder.glob("data/*/*.parquet"))]
    return {name: np.concatenate([np.array(t[name].to_pylist()) for t in tables]) for name in tables[0].column_names}


def named(scene: Scene, name: str, category: str = "box") -> Scene:
    T = scene.T_hand_obj.copy()
    T[:, 2, 3] += len(name) / 100.0
    return replace(scene, name=name, category=category, T_hand_obj=T)


@pytest.mark.slow
def test_episodes_are_counted_on_and_statistics_are_those_of_all(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    scenes = [named(scene, "a"), named(scene, "bb", "mug"), named(scene, "ccc")]
    dataset = Dataset.of(folder)
    assert [dataset.add(one) for one in scenes[:2]] == [0, 1]
    again = Dataset.of(folder)
    assert again.clips == {"a", "bb"}
    assert again.add(scenes[2]) == 2
    rows, info = columns(folder), json.loads((folder / "meta" / "info.json").read_text())
    assert rows["episode_index"].tolist() == [0] * 3 + [1] * 3 + [2] * 3
    assert rows["index"].tolist() == list(range(9))
    assert rows["frame_index"].tolist() == [0, 1, 2] * 3
    assert rows["task_index"].tolist() == [0] * 3 + [1] * 3 + [0] * 3
    assert [info[f"total_{what}"] for what in ("episodes", "frames", "tasks")] == [3, 9, 2]
    assert info["splits"] == {"train": "0:3"}
    stats = json.loads((folder / "meta" / "stats.json").read_text())
    for name in ("observation.environment_state", "index", "episode_index"):
        whole = statistics(rows[name])
        for key in ("min", "max", "mean", "std", "count"):
            np.testing.assert_allclose(stats[name][key], whole[key], atol=1e-6)


@pytest.mark.slow
def test_an_episode_that_was_not_finished_is_written_anew(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    Dataset.of(folder).add(named(scene, "a"))
    kept = (folder / "meta" / "info.json").read_bytes()
    Dataset.of(folder).add(named(scene, "killed"))
    (folder / "meta" / "info.json").write_bytes(kept)  # as where the process ends before it
    dataset = Dataset.of(folder)
    assert dataset.clips == {"a"}
    assert dataset.add(named(scene, "bb")) == 1
    assert Dataset.of(folder).clips == {"a", "bb"}
    assert len(columns(folder)["index"]) == 6


def test_what_does_not_belong_is_refused(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    Dataset.of(folder).add(named(scene, "a"))
    with pytest.raises(InputError, match="frames per second"):
        Dataset.of(folder).add(replace(named(scene, "b"), time=10.0 * scene.time))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    with pytest.raises(InputError, match="other files"):
        Dataset.of(tmp_path / "mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "data").symlink_to(tmp_path / "other")
    with pytest.raises(UsageError, match="link"):
        Dataset.of(tmp_path / "new").add(named(scene, "a"))
    assert list((tmp_path / "other").iterdir()) == []
