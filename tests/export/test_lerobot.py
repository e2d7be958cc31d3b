"""LeRobot: Parquet files, records and videos that agree; a dataset of many results that goes on after any end."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.export import Scene, export
from getagrip.export.lerobot import CAMERA_FEATURE, STATE_COMPONENTS, feature_statistics, image_stats, integer_fps
from getagrip.export.lerobot_dataset import LerobotDataset
from getagrip.export.scene import StageFrame
from getagrip.geometry import se3
from getagrip.io.images import write_image
from helpers.environment import needs_library

pytestmark = needs_library("pyarrow", "lerobot")
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"


def read(folder: Path, name: str) -> Any:
    return json.loads((folder / "meta" / name).read_text())


def table_in(path: Path) -> Any:
    from pyarrow import parquet

    return parquet.read_table(path)


def with_images(scene: Scene, folder: Path, size: tuple[int, int] = (64, 48)) -> Scene:
    """Grey images that brighten from frame to frame."""
    folder.mkdir()
    paths = tuple(folder / f"{n}.png" for n in range(len(scene.frames)))
    for n, path in enumerate(paths):
        write_image(path, np.full((size[1], size[0], 3), 50 + 50 * n, np.uint8))
    return replace(scene, image_files=paths, size=size)


def test_rows_are_the_frames(scene: Scene, tmp_path: Path) -> None:
    folder = export(scene, tmp_path / "out", "lerobot")
    info, table = read(folder, "info.json"), table_in(folder / DATA)
    columns = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    assert {*info["features"]} == {*columns}
    for name, feature in info["features"].items():
        kind = table.schema.field(name).type
        found = str(kind if feature["shape"] == [1] else kind.value_type)
        assert found == {"float32": "float", "float64": "double"}.get(feature["dtype"], feature["dtype"])
        assert feature["shape"] == (list(columns[name].shape[1:]) or [1])
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    T_stage_obj, T_stage_hand = StageFrame.of(scene).poses(scene)
    joints = se3.transform(T_stage_hand, scene.joints)
    state = columns["observation.state"]
    np.testing.assert_allclose(state[:, :3], joints[:, 0], atol=1e-6)
    np.testing.assert_allclose(se3.from_quaternion(state[:, 3:7]), T_stage_hand[:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(state[:, 7:].reshape(-1, 21, 3), joints, atol=1e-6)
    np.testing.assert_array_equal(columns["action"], state[[1, 2, 2]])
    held = columns["observation.environment_state"]
    np.testing.assert_allclose(held[:, :3], T_stage_obj[:, :3, 3], atol=1e-6)
    for name, T in scene.poses.items():
        np.testing.assert_allclose(columns[name].reshape(-1, 4, 4), T, atol=1e-6)
    np.testing.assert_array_equal(columns["time_s"], scene.time)
    np.testing.assert_allclose(columns["timestamp"], np.arange(3) / info["fps"], atol=1e-6)
    assert columns["frame_kind"].tolist() == ["sampled", "fitted", "interpolated"]
    assert columns["interpolated"].tolist() == [False, False, True]
    assert (info["codebase_version"], info["total_frames"], info["video_path"]) == ("v3.0", 3, None)
    assert len(STATE_COMPONENTS) == 70


def test_records_agree_with_the_rows(scene: Scene, tmp_path: Path) -> None:
    folder = export(scene, tmp_path / "out", "lerobot")
    info, stats = read(folder, "info.json"), read(folder, "stats.json")
    tasks = table_in(folder / "meta" / "tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["hold the box with the right hand"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    (episode,) = table_in(folder / EPISODES).to_pylist()
    assert episode["tasks"] == tasks["task"].to_pylist()
    assert (episode["dataset_from_index"], episode["dataset_to_index"], episode["length"]) == (0, 3, 3)
    assert {*stats} == {name for name, feature in info["features"].items() if feature["dtype"] != "string"}
    for name, of in stats.items():
        for key, value in of.items():
            np.testing.assert_allclose(episode[f"stats/{name}/{key}"], value)
            assert len(value) == (1 if key == "count" else info["features"][name]["shape"][0])


@pytest.mark.slow
def test_the_video_shows_each_frame_at_its_timestamp(scene: Scene, tmp_path: Path) -> None:
    scene = with_images(scene, tmp_path / "images", (65, 48))  # H.264 wants even sides
    folder = export(scene, tmp_path / "out", "lerobot")
    info, stats = read(folder, "info.json"), read(folder, "stats.json")
    assert info["features"][CAMERA_FEATURE]["shape"] == [48, 64, 3]
    path = folder / info["video_path"].format(video_key=CAMERA_FEATURE, chunk_index=0, file_index=0)
    stamps = table_in(folder / DATA)["timestamp"].to_pylist()
    with av.open(str(path)) as film:
        frames = list(film.decode(film.streams.video[0]))
        assert [frame.time for frame in frames] == pytest.approx(stamps, abs=1e-4)
        seen = [frame.to_ndarray(format="rgb24") for frame in frames]
    assert seen[0].shape == (48, 64, 3)
    assert [picture.mean() for picture in seen] == pytest.approx([50.0, 100.0, 150.0], abs=3.0)
    assert np.shape(stats[CAMERA_FEATURE]["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(stats[CAMERA_FEATURE]["mean"], 100.0 / 255.0)
    (episode,) = table_in(folder / EPISODES).to_pylist()
    assert episode[f"videos/{CAMERA_FEATURE}/to_timestamp"] == pytest.approx(3 / info["fps"])


def test_statistics_are_numpys() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((40, 3))
    found = feature_statistics(values)
    np.testing.assert_allclose(found["std"], values.std(axis=0))
    np.testing.assert_allclose(found["q10"], np.quantile(values, 0.1, axis=0))
    images = rng.integers(20, 200, (4, 12, 16, 3), np.uint8)
    levels = images.reshape(-1, 3) / 255.0
    of = image_stats(images)
    for key, expected in {"mean": levels.mean(axis=0), "std": levels.std(axis=0), "max": levels.max(axis=0)}.items():
        np.testing.assert_allclose(of[key].ravel(), expected)
    np.testing.assert_allclose(of["q50"].ravel(), np.quantile(levels, 0.5, axis=0), atol=1.0 / 255.0)


def test_what_cannot_be_written_is_named(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"missing joints in hand\.npz of the clip small: --to lerobot"):
        export(replace(scene, joints=None), tmp_path / "out", "lerobot")
    broken = with_images(scene, tmp_path / "images")
    (tmp_path / "images" / "1.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"1\.png must be .*got a damaged file, or no PNG"):
        export(broken, tmp_path / "out", "lerobot")
    write_image(tmp_path / "images" / "1.png", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(InputError, match=r"must be 64 x 48.*8 x 8 pixels"):
        export(broken, tmp_path / "out", "lerobot")
    assert integer_fps(replace(scene, time=np.array([0.0, 1 / 29.97, 2 / 29.97]))) == 30


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
            replace(named(scene, name), probability=0.75, findings_serious=2, distance_interval=(0.5, 0.625)),
            "test" if name in tests else "train",
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
    assert {tuple(each) for each in rows["distance_interval"].tolist()} == {(0.5, 0.625), (-1.0, -1.0)}
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
