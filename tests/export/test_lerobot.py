"""LeRobot: Parquet files, records and video that say the same, as its readers want them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.export import Scene, export
from getagrip.export.lerobot import CAMERA_FEATURE, STATE_COMPONENTS, feature_statistics, image_stats, integer_fps
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
