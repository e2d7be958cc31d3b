"""LeRobot: a dataset, version 3.0, of one episode (https://github.com/huggingface/lerobot); many: ``lerobot_dataset``.

Each frame has the wrist's pose and the 21 joints (``observation.state``) and the object's pose
(``observation.environment_state``) in the stage frame (z up); quaternions are (w, x, y, z). People give no commands:
``action`` is the state of the next frame. LeRobot assumes evenly spaced frames: ``timestamp`` is n / fps, at the clip's
rate rounded to a whole number, and uneven clips are resampled; ``time_s`` is the clip's own time. Images, if every
frame has one, are a video. ``confidence`` is the calibrated probability that the result is right relative to the hand,
else -1; ``findings_serious`` the number of serious findings, 0 for a right result; ``distance_interval`` contains the
object's distance from the camera, median over frames, with 90 % [m], -1 where unknown; ``mask_iou`` is the mask IOU of
the frame, -1 without a mask that shows the object.

A clip with views has a video of each that has an image in every frame, ``observation.images.NAME``, and of each camera
the intrinsics ``K_NAME``, row by row, and the pose ``T_cam_NAME``; of the clip's own camera ``K_camera``.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray

from getagrip.export.scene import HAND_JOINT_NAMES, Scene, StageFrame, joints_on_stage, pose7
from getagrip.io import files, plugins
from getagrip.io.images import read_image, write_video

if TYPE_CHECKING:
    import pyarrow

LEROBOT_VERSION = "v3.0"
CHUNK_FILE_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_FILE_PATTERN = f"data/{CHUNK_FILE_PATTERN}.parquet"
EPISODES_FILE_PATTERN = f"meta/episodes/{CHUNK_FILE_PATTERN}.parquet"
VIDEO_FILE_PATTERN, IMAGES_PREFIX = "videos/{video_key}/" + f"{CHUNK_FILE_PATTERN}.mp4", "observation.images."
CAMERA_FEATURE = f"{IMAGES_PREFIX}camera"
"""Images of the clip's own camera."""
POSE_COMPONENTS = ("x", "y", "z", "qw", "qx", "qy", "qz")
STATE_COMPONENTS = [
    *(f"wrist_{name}" for name in POSE_COMPONENTS),
    *(f"{joint}_{axis}" for joint in HAND_JOINT_NAMES for axis in "xyz"),
]
COMPONENT_NAMES = {
    "observation.state": STATE_COMPONENTS,
    "action": STATE_COMPONENTS,
    "distance_interval": ["low", "high"],
    "observation.environment_state": [f"object_{name}" for name in POSE_COMPONENTS],
}
"""Names of the numbers of features."""
STATISTICS_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
N_EPISODES_PER_CHUNK = 1000
"""Episodes whose files share a folder."""
MAX_STATISTICS_PIXELS = 200_000
"""Maximum number of pixels of an image that statistics use."""


class Episode(NamedTuple):
    """A scene in LeRobot's terms: rows, features and statistics by name, the task in words, images by feature."""

    columns: dict[str, Shaped[ndarray, "T ..."]]
    features: dict[str, object]
    stats: dict[str, dict[str, Shaped[ndarray, "..."]]]
    task: str
    pictures: dict[str, EpisodeImages]
    fps: int
    stage: StageFrame

    @staticmethod
    def of(scene: Scene) -> Episode:
        """Make an episode. Raises ``UsageError`` without pyarrow or joints, ``InputError`` for unreadable images."""
        plugins.import_extra("pyarrow", "lerobot")
        scene = scene.even(integer_fps(scene))
        stage, pictures, fps = StageFrame.of(scene), EpisodeImages.of(scene), integer_fps(scene)
        columns = _feature_columns(scene, stage)
        features: dict[str, object] = {
            name: {
                "dtype": "string" if values.dtype.kind == "U" else str(values.dtype),
                "shape": list(values.shape[1:]) or [1],
                "names": COMPONENT_NAMES.get(name),
            }
            for name, values in columns.items()
        }
        stats = {name: feature_statistics(values) for name, values in columns.items() if values.dtype.kind != "U"}
        for name, images in pictures.items():
            features[name], stats[name] = images.feature(fps), image_stats(iter(images))
        task = f"hold the {scene.category} with the {scene.side} hand"
        return Episode(columns, features, stats, task, pictures, fps, stage)

    def write(
        self, folder: Path, number: int = 0, begin: int = 0, task: int = 0, more: Mapping[str, str] | None = None
    ) -> dict[str, object]:
        """Write the episode's files into a dataset, and return its record.

        ``begin`` is the number of frames of the episodes before it, ``task`` the index of its task, ``more`` further
        fields of the record.
        """
        place, count = chunk_indices(number), len(self.columns["index"])
        offsets = {"episode_index": number, "index": begin, "task_index": task}
        moved = {name: self.columns[name] + offset for name, offset in offsets.items()}
        columns = self.columns | moved
        record: dict[str, object] = {
            "episode_index": number,
            "tasks": [self.task],
            "length": count,
            "dataset_from_index": begin,
            "dataset_to_index": begin + count,
            **{f"data/{key}": value for key, value in place.items()},
            **{f"meta/episodes/{key}": value for key, value in place.items()},
        }
        for name, images in self.pictures.items():
            path = _path_in_dataset(folder, VIDEO_FILE_PATTERN.format(video_key=name, **place))
            write_video(path, iter(images), Fraction(self.fps), images.size, seek=True)
            about = {**place, "from_timestamp": 0.0, "to_timestamp": count / self.fps}
            record |= {f"videos/{name}/{key}": value for key, value in about.items()}
        stats = self.stats | {name: feature_statistics(values) for name, values in moved.items()}
        record |= {f"stats/{name}/{key}": value for name, of in stats.items() for key, value in of.items()}
        record |= more or {}
        _write_table(_path_in_dataset(folder, DATA_FILE_PATTERN.format(**place)), columns)
        row = {key: [value.tolist() if isinstance(value, ndarray) else value] for key, value in record.items()}
        _write_table(_path_in_dataset(folder, EPISODES_FILE_PATTERN.format(**place)), row)
        return record


def chunk_indices(number: int) -> dict[str, int]:
    """Return the indices of an episode's folder and file, for the file patterns."""
    return {"chunk_index": number // N_EPISODES_PER_CHUNK, "file_index": number % N_EPISODES_PER_CHUNK}


def _path_in_dataset(folder: Path, name: str) -> Path:
    """Return the path of a file in a dataset, and make its folder."""
    *folders, last = name.split("/")
    return files.folder_inside(folder, *folders) / last


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write a dataset of one episode. Raises as ``Episode.of`` does."""
    made = Episode.of(scene)
    made.write(folder)
    write_meta(folder, made, [made.task], made.stats, {"train": "0:1"}, len(made.columns["index"]))
    place = chunk_indices(0)
    about = {
        DATA_FILE_PATTERN.format(**place): f"a row per frame; {made.stage.words}; quaternions (w, x, y, z); T_a_b row "
        "by row; action is the next frame's state (a guess: people give no commands)",
        EPISODES_FILE_PATTERN.format(**place): "the one episode, with its statistics; the same units",
        "meta/tasks.parquet": "the task in words, in the same order as task_index",
        "meta/stats.json": "statistics of each feature, in the same units; images from 0 to 1",
        "meta/info.json": "the dataset's features; the same units",
    }
    for name in made.pictures:
        about[VIDEO_FILE_PATTERN.format(video_key=name, **place)] = "the images, H.264, at the same fps"
    return about


def write_meta(
    folder: Path,
    made: Episode,
    tasks: Sequence[str],
    stats: Mapping[str, object],
    splits: Mapping[str, str],
    frames: int,
) -> None:
    """Write tasks and statistics, then ``info.json``, which completes the dataset; ``frames`` counts all frames."""
    _write_tasks(folder / "meta" / "tasks.parquet", tasks)
    files.write_json(folder / "meta" / "stats.json", stats)
    files.write_json(folder / "meta" / "info.json", _dataset_info(made, splits, frames, len(tasks)))


def integer_fps(scene: Scene) -> int:
    """Return the frame rate of the median time step, rounded to a whole number."""
    step = float(np.median(np.diff(scene.time))) if len(scene.frames) > 1 else 1.0 / scene.fps
    return int(np.clip(round(1.0 / step), 1, 1000))


class EpisodeImages:
    """The images of all frames, cropped to an even width and height for H.264; read one at a time."""

    def __init__(self, paths: list[Path], whole: tuple[int, int]) -> None:
        self.paths, self.whole = paths, whole
        self.size = (whole[0] // 2 * 2, whole[1] // 2 * 2)

    @staticmethod
    def of(scene: Scene) -> dict[str, EpisodeImages]:
        """Return the images of each camera of a scene that has one in every frame, by feature."""
        found = {}
        for camera in scene.cameras:
            paths = [path for path in camera.image_files if path is not None]
            if len(paths) == len(scene.frames):
                found[f"{IMAGES_PREFIX}{camera.name}"] = EpisodeImages(paths, camera.size)
        return found

    def __iter__(self) -> Iterator[UInt8[ndarray, "H W 3"]]:
        width, height = self.size
        for path in self.paths:
            yield read_image(path, self.whole)[:height, :width]

    def feature(self, fps: int) -> dict[str, object]:
        """Describe the video as LeRobot's feature."""
        width, height = self.size
        about = {"height": height, "width": width, "codec": "h264", "pix_fmt": "yuv420p", "is_depth_map": False}
        info = {f"video.{key}": value for key, value in {**about, "fps": fps, "channels": 3}.items()}
        names = ["height", "width", "channels"]
        return {"dtype": "video", "shape": [height, width, 3], "names": names, "info": info | {"has_audio": False}}


def _feature_columns(scene: Scene, stage: StageFrame) -> dict[str, Shaped[ndarray, "T ..."]]:
    """Return all features but the video, by name."""
    joints = joints_on_stage(scene, stage, "lerobot")
    T_stage_obj, T_stage_hand = stage.poses(scene)
    wrist = T_stage_hand.copy()
    wrist[:, :3, 3] = joints[:, 0]
    count = len(joints)
    state = np.concatenate([pose7(wrist, "wxyz"), joints.reshape(count, -1)], axis=1).astype(np.float32)
    number = np.arange(count)
    cameras = {f"K_{camera.name}": camera.K.reshape(count, 9) for camera in scene.cameras if scene.views}
    cameras |= {f"T_cam_{view.name}": view.T_cam_view.reshape(count, 16) for view in scene.views}
    return {
        "observation.state": state,
        "observation.environment_state": pose7(T_stage_obj, "wxyz").astype(np.float32),
        "action": np.concatenate([state[1:], state[-1:]]),
        **{name: T.reshape(count, 16).astype(np.float32) for name, T in scene.poses.items()},
        **{name: values.astype(np.float32) for name, values in cameras.items()},
        "time_s": scene.time,
        "confidence": np.full(count, -1.0 if scene.probability is None else scene.probability, dtype=np.float32),
        "findings_serious": np.full(count, scene.findings_serious),
        "distance_interval": np.tile(np.array(scene.distance_interval or (-1.0, -1.0), np.float32), (count, 1)),
        "mask_iou": np.nan_to_num(scene.iou, nan=-1.0).astype(np.float32),
        "interpolated": np.array([kind == "interpolated" for kind in scene.frame_kind]),
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
        "timestamp": (number / integer_fps(scene)).astype(np.float32),
        "frame_index": number,
        "episode_index": np.zeros_like(number),
        "index": number,
        "task_index": np.zeros_like(number),
    }


def _dataset_info(made: Episode, splits: Mapping[str, str], frames: int, tasks: int) -> dict[str, object]:
    ends = [int(each.split(":")[1]) for ranges in splits.values() for each in ranges.split(",")]
    return {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": "human_hand",
        "total_episodes": max(ends),
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": N_EPISODES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": made.fps,
        "splits": splits,
        "data_path": DATA_FILE_PATTERN,
        "video_path": VIDEO_FILE_PATTERN if made.pictures else None,
        "features": made.features,
    }


def _write_table(path: Path, columns: Mapping[str, object], metadata: dict[bytes, bytes] | None = None) -> None:
    """Write a Parquet file; rows of 2D arrays become lists of fixed length."""
    pa, parquet = plugins.import_extra("pyarrow", "lerobot"), plugins.import_extra("pyarrow.parquet", "lerobot")

    def column(values: object) -> pyarrow.Array:
        if isinstance(values, ndarray) and values.ndim == 2:
            return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        return pa.array(values.tolist() if isinstance(values, ndarray) and values.dtype.kind == "U" else values)

    table = pa.table({name: column(values) for name, values in columns.items()})
    content = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata(metadata) if metadata else table, content)
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_bytes(path, content.getvalue())


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks with metadata that make the task the table's index for pandas, as LeRobot expects."""

    def about(name: str, kind: str, numpy_type: str) -> dict[str, object]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type, "metadata": None}

    columns = [about("task_index", "int64", "int64"), about("task", "unicode", "object")]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = {"task_index": list(range(len(tasks))), "task": list(tasks)}
    _write_table(path, table, {b"pandas": json.dumps(pandas).encode()})


def feature_statistics(values: Shaped[ndarray, "T ..."]) -> dict[str, Shaped[ndarray, "..."]]:
    """Compute statistics over all frames, for each entry of a feature."""
    rows = values.reshape(len(values), -1).astype(float)
    low, high, mean, std = rows.min(axis=0), rows.max(axis=0), rows.mean(axis=0), rows.std(axis=0)
    quantiles = {f"q{round(100 * q):02d}": np.quantile(rows, q, axis=0) for q in STATISTICS_QUANTILES}
    return {"min": low, "max": high, "mean": mean, "std": std, "count": np.array([len(rows)]), **quantiles}


def image_stats(images: Iterable[UInt8[ndarray, "H W 3"]]) -> dict[str, Shaped[ndarray, "..."]]:
    """Compute statistics of the three channels, from 0 to 1, over all images, as arrays (3, 1, 1)."""
    histogram, count = np.zeros((3, 256)), 0
    for image in images:
        step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / MAX_STATISTICS_PIXELS)))
        histogram += [np.bincount(image[::step, ::step, k].ravel(), minlength=256) for k in range(3)]
        count += 1
    levels = np.arange(256) / 255.0
    share = histogram / histogram.sum(axis=1, keepdims=True)
    mean, total = share @ levels, np.cumsum(share, axis=1)
    present = [np.flatnonzero(of) for of in histogram]
    out = {
        "min": levels[[of[0] for of in present]],
        "max": levels[[of[-1] for of in present]],
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0)),
        **{f"q{round(100 * q):02d}": levels[np.argmax(total >= q, axis=1)] for q in STATISTICS_QUANTILES},
    }
    return {key: value.reshape(3, 1, 1) for key, value in out.items()} | {"count": np.array([count])}
