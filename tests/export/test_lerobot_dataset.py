"""Many results as one dataset of LeRobot: rows, records and totals agree, and it can be continued after any end."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.export import Scene
from getagrip.export.lerobot import feature_statistics
from getagrip.export.lerobot_dataset import LerobotDataset
from helpers.environment import needs_library

pytestmark = needs_library("pyarrow", "lerobot")


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
    dataset = LerobotDataset.of(folder)
    assert [dataset.add(one) for one in scenes[:2]] == [0, 1]
    again = LerobotDataset.of(folder)
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
        whole = feature_statistics(rows[name])
        for key in ("min", "max", "mean", "std", "count"):
            np.testing.assert_allclose(stats[name][key], whole[key], atol=1e-6)


@pytest.mark.slow
def test_clips_stay_in_their_split_as_the_dataset_grows(scene: Scene, tmp_path: Path) -> None:
    names = [f"clip-{n}" for n in range(8)]
    dataset = LerobotDataset.of(tmp_path / "set")
    tests = dataset.tests(names, 0.25)
    assert len(tests) == 2
    assert tests == dataset.tests(names[::-1], 0.25)
    for name in sorted(names, key=lambda name: name in tests):
        dataset.add(
            replace(named(scene, name), probability=0.75, findings_serious=2), "test" if name in tests else "train"
        )
    again = LerobotDataset.of(tmp_path / "set")
    assert again.splits == {"train": "0:6", "test": "6:8"}
    assert again.tests(names, 0.25) == set()
    assert len(again.tests([*names, "new-1", "new-2", "new-3", "new-4"], 0.25)) == 1
    again.add(named(scene, "new-1"))
    assert json.loads((tmp_path / "set/meta/info.json").read_text())["splits"] == {"train": "0:6,8:9", "test": "6:8"}
    rows = columns(tmp_path / "set")
    assert {*rows["confidence"].tolist()} == {0.75, -1.0}
    assert {*rows["findings_serious"].tolist()} == {2, 0}
    np.testing.assert_allclose(rows["mask_iou"][:3], np.nan_to_num(scene.iou, nan=-1.0))
    assert rows["interpolated"][:3].tolist() == [False, False, True]


@pytest.mark.slow
def test_an_episode_that_was_not_finished_is_written_anew(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    LerobotDataset.of(folder).add(named(scene, "a"))
    kept = (folder / "meta" / "info.json").read_bytes()
    LerobotDataset.of(folder).add(named(scene, "killed"))
    (folder / "meta" / "info.json").write_bytes(kept)  # as where the process ends before it
    dataset = LerobotDataset.of(folder)
    assert dataset.clips == {"a"}
    assert dataset.add(named(scene, "bb")) == 1
    assert LerobotDataset.of(folder).clips == {"a", "bb"}
    assert len(columns(folder)["index"]) == 6


@pytest.mark.slow
def test_a_process_that_is_killed_leaves_a_dataset_that_goes_on(scene: Scene, tmp_path: Path) -> None:
    """At each file that takes its place, as SIGKILL ends it: no clean-up is run."""
    images = tuple(tmp_path / f"{n}.png" for n in range(3))
    for n, path in enumerate(images):
        cv2.imwrite(str(path), np.full((scene.size[1], scene.size[0], 3), 80 * n, np.uint8))
    scenes = [replace(named(scene, name), image_files=images) for name in ("a", "bb", "ccc")]
    for at in range(12):
        folder = tmp_path / f"set-{at}"
        LerobotDataset.of(folder).add(scenes[0])
        if (process := os.fork()) == 0:
            left = iter(range(at))

            def replaced(*paths: object, put: Callable[..., None] = os.replace, left: Iterator[int] = left) -> None:
                if next(left, None) is None:
                    os.kill(os.getpid(), signal.SIGKILL)
                put(*paths)

            os.replace = replaced
            LerobotDataset.of(folder).add(scenes[1])
            os._exit(0)
        os.waitpid(process, 0)
        read = [*folder.glob("data/*/*.parquet"), *folder.glob("meta/episodes/*/*.parquet")]
        assert not any(path.name.startswith(".") for path in read)  # LeRobot reads all of these, in the order of names
        total = json.loads((folder / "meta" / "info.json").read_text())["total_frames"]
        np.testing.assert_array_equal(columns(folder)["index"][:total], np.arange(total))
        dataset = LerobotDataset.of(folder)
        for one in scenes:
            if one.name not in dataset.clips:
                dataset.add(one)
        assert {path.name for path in folder.iterdir()} == {"data", "meta", "videos"}
        assert columns(folder)["index"].tolist() == list(range(9))
        assert len([*folder.glob("videos/*/*/*.mp4")]) == 3
    assert at > total // 3  # the last ends are after the last file


@pytest.mark.slow
def test_two_processes_add_to_one_dataset(scene: Scene, tmp_path: Path) -> None:
    """In whatever order their turns come: every clip once, and rows, records and totals agree."""
    folder, names = tmp_path / "set", ["a", "bb", "ccc", "dddd", "eeeee"]
    processes = []
    for own in (names[:4], names[:0:-1]):  # three clips are both processes' own
        if (process := os.fork()) == 0:
            status = 1
            try:
                dataset = LerobotDataset.of(folder)
                for name in own:
                    dataset.add(named(scene, name, "mug" if name == "bb" else "box"))
                status = 0
            finally:
                os._exit(status)
        processes.append(process)
    assert [os.waitpid(process, 0)[1] for process in processes] == [0, 0]
    dataset = LerobotDataset.of(folder)
    assert sorted(str(record["clip"]) for record in dataset.records) == names
    rows, info = columns(folder), json.loads((folder / "meta" / "info.json").read_text())
    assert [info[f"total_{what}"] for what in ("episodes", "frames", "tasks")] == [5, 15, 2]
    assert rows["index"].tolist() == list(range(15))
    assert rows["episode_index"].tolist() == [n for n in range(5) for _ in range(3)]
    mugs = [n for n, record in enumerate(dataset.records) if record["clip"] == "bb"]
    assert {*rows["task_index"][np.isin(rows["episode_index"], mugs)]}.isdisjoint(
        rows["task_index"][~np.isin(rows["episode_index"], mugs)]
    )
    assert {path.name for path in folder.iterdir()} == {"data", "meta"}


def in_info(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        content = json.loads((folder / "meta" / "info.json").read_text())
        change(content)
        (folder / "meta" / "info.json").write_text(json.dumps(content))

    return damage


def in_record(change: Callable[[dict[str, Any]], object], rows: int = 1) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        (path,) = folder.glob("meta/episodes/*/*.parquet")
        (record,) = parquet.read_table(path).to_pylist()
        change(record)
        parquet.write_table(pa.table({key: [value] * rows for key, value in record.items()}), path)

    return damage


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no rate": in_info(lambda info: info.pop("fps")), "no features": in_info(lambda info: info.pop("features")),
    "a rate in words": in_info(lambda info: info.update(fps="30")),
    "a count below 0": in_info(lambda info: info.update(total_episodes=-1)),
    "another count": in_info(lambda info: info.update(total_episodes=2)),
    "a feature without a shape": in_info(lambda info: info["features"]["action"].pop("shape")),
    "another feature": in_info(lambda info: info["features"].update(force={"dtype": "float32", "shape": [3]})),
    "no statistic": in_record(lambda record: record.pop("stats/action/mean")),
    "a statistic in words": in_record(lambda record: record.update({"stats/action/mean": ["a"]})),
    "a shorter statistic": in_record(lambda record: record["stats/action/mean"].pop()),
    "a missing number": in_record(lambda record: record["stats/action/mean"].__setitem__(0, None)),
    "no task": in_record(lambda record: record.pop("tasks")),
    "no length": in_record(lambda record: record.pop("length")),
    "another end": in_record(lambda record: record.update(dataset_to_index=1000)),
    "two rows": in_record(lambda record: None, rows=2),
    "no record": lambda folder: next(folder.glob("meta/episodes/*/*.parquet")).unlink(),
    "no data": lambda folder: next(folder.glob("data/*/*.parquet")).unlink(),
    "half a record": lambda folder: (path := next(folder.glob("meta/episodes/*/*.parquet"))).write_bytes(
        path.read_bytes()[:500]),
    "more data": lambda folder: (folder / "data" / "chunk-000" / "file-007.parquet").touch(),
    "no description": lambda folder: (
        (folder / "meta" / "info.json").unlink(), (folder / "data" / "chunk-000" / "file-001.parquet").touch()),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_dataset_is_refused_and_stays_as_it_is(scene: Scene, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "set"
    LerobotDataset.of(folder).add(named(scene, "a"))
    DAMAGES[damage](folder)
    before = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    with pytest.raises(InputError) as caught:
        LerobotDataset.of(folder).add(named(scene, "bb"))
    assert str(caught.value).startswith(str(folder))
    assert {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()} == before


def test_what_does_not_belong_is_refused(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    LerobotDataset.of(folder).add(named(scene, "a"))
    with pytest.raises(InputError, match="frames per second"):
        LerobotDataset.of(folder).add(replace(named(scene, "b"), time=10.0 * scene.time))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    with pytest.raises(InputError, match="other files"):
        LerobotDataset.of(tmp_path / "mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "data").symlink_to(tmp_path / "other")
    with pytest.raises(UsageError, match="link"):
        LerobotDataset.of(tmp_path / "new").add(named(scene, "a"))
    assert list((tmp_path / "other").iterdir()) == []
