"""A LeRobot dataset of many results that can be continued; each result is an episode with its own files.

LeRobot reads all files of its folders, complete or not: an episode's files are written to a temporary folder and then
moved. ``meta/info.json`` is written last; files that it does not count are overwritten, so that an interruption loses
only the current episode. Several processes may add episodes, one at a time, each after the others' (on a system without
locks only one process may). Each record in ``meta/episodes`` has the clip's name as ``clip``, and ``train`` or ``test``
as ``split``; ``splits`` in ``info.json`` has the ranges of both, separated by commas.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import cast

import numpy as np
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.export.lerobot import (
    DATA_FILE_PATTERN,
    EPISODES_FILE_PATTERN,
    STATISTICS_QUANTILES,
    VIDEO_FILE_PATTERN,
    Episode,
    chunk_indices,
    write_meta,
)
from getagrip.export.scene import Scene
from getagrip.io import arrays, files, plugins
from getagrip.io.files import Json

STATISTIC_NAMES = ("min", "max", "mean", "std", "count", *(f"q{round(100 * q):02d}" for q in STATISTICS_QUANTILES))
"""Statistics in a record, of each numeric feature."""


@dataclass
class LerobotDataset:
    """The dataset in a folder.

    Attributes:
        folder: the dataset's folder.
        info: the content of ``meta/info.json``; empty for a new dataset.
        records: the record of each episode.
        tasks: the tasks in words.
    """

    folder: Path
    info: Json = field(default_factory=dict)
    records: list[Json] = field(default_factory=list)
    tasks: list[str] = field(default_factory=list)

    @staticmethod
    def of(folder: Path) -> LerobotDataset:
        """Open the dataset in a folder, or begin one. Raises ``InputError`` for a folder of other files."""
        made = LerobotDataset(folder)
        if folder.is_dir():
            files.remove_stale_folders(folder)
            with files.hold_lock(folder):  # else another process may add episodes after info.json was read
                made._catch_up()
        if not made.info and folder.exists() and {one.name for one in folder.iterdir()} - {"data", "meta", "videos"}:
            raise InputError(folder, "", "other files", "a dataset of LeRobot, or a new folder")
        return made

    def _catch_up(self) -> None:
        """Read the episodes that other processes have added. Raises ``InputError`` for a damaged one.

        Nothing is then added to a dataset that could not be completed.
        """
        path = self.folder / "meta" / "info.json"
        if not path.exists():
            self._refuse_others(path, 0)
            return
        parquet = plugins.import_extra("pyarrow.parquet", "lerobot")
        self.info = files.read_json(files.inside(self.folder, "meta/info.json", "", "the dataset's description"))
        _check_info(path, self.info)
        self._refuse_others(path, self.info["total_episodes"])
        for number in range(len(self.records), self.info["total_episodes"]):
            place = chunk_indices(number)
            source = files.inside(self.folder, EPISODES_FILE_PATTERN.format(**place), "", "an episode's record")
            files.inside(self.folder, DATA_FILE_PATTERN.format(**place), "", "an episode's data")
            for name in (name for name, feature in self.info["features"].items() if feature["dtype"] == "video"):
                video = VIDEO_FILE_PATTERN.format(video_key=name, **place)
                files.inside(self.folder, video, "", "an episode's video")
            try:
                with arrays.convert_to_input_errors(source):
                    table = parquet.ParquetFile(source)
                    if table.metadata.num_rows != 1:
                        raise InputError(source, "", f"{table.metadata.num_rows} rows", "one, the episode's record")
                    (record,) = table.read().to_pylist()
                    record |= {key: np.array(value) for key, value in record.items() if key.startswith("stats/")}
            except OSError as error:
                raise InputError(source, "", f"a damaged file ({error})", "an episode's record") from error
            begin = self.records[-1]["dataset_to_index"] if self.records else 0
            _check_record(source, record, self.info["features"], number, begin)
            self.records.append(record)
            self.tasks += [task for task in record["tasks"] if task not in self.tasks]

    def _refuse_others(self, path: Path, total: int) -> None:
        """Raise ``InputError`` for files of episodes beyond ``total``, except one incomplete episode."""
        patterns, places = (DATA_FILE_PATTERN, EPISODES_FILE_PATTERN), list(map(chunk_indices, range(total + 1)))
        counted = {pattern.format(**place) for pattern in patterns for place in places}
        for pattern in ("data/*/*.parquet", "meta/episodes/*/*.parquet"):
            for found in sorted(self.folder.glob(pattern)):
                if (name := found.relative_to(self.folder).as_posix()) not in counted:
                    got = f"{total}, and {files.printable(name)}"
                    raise InputError(path, "total_episodes", got, "the files' count")

    @property
    def clips(self) -> set[str]:
        """The clips whose results the dataset has."""
        return {str(record.get("clip", "")) for record in self.records}

    def tests(self, clips: Collection[str], share: float) -> set[str]:
        """Choose test clips among new ones, so that the fraction ``share`` of all clips, new and old, is for tests.

        The choice depends on checksums of names, not on order. The dataset's own episodes keep their split.
        """
        new = sorted({*clips} - self.clips, key=lambda clip: hashlib.sha256(clip.encode()).digest())
        old_tests = sum(record.get("split") == "test" for record in self.records)
        return {*new[: max(0, round(share * (len(self.records) + len(new))) - old_tests)]}

    def add(self, scene: Scene, split: str = "train") -> int:
        """Add a scene as the last episode, in ``split``; return its index, or the index that the clip's episode has.

        Raises ``InputError`` for another frame rate or other features than the dataset's, and as ``Episode.of``.
        """
        made = Episode.of(scene)
        files.folder_inside(self.folder, "meta")
        with files.hold_lock(self.folder):
            self._catch_up()
            clips = [record.get("clip") for record in self.records]
            return clips.index(scene.name) if scene.name in clips else self._append(made, scene.name, split)

    def _append(self, made: Episode, clip: str, split: str) -> int:
        """Write an episode behind the last one; the folder is locked."""
        number = len(self.records)
        self._check(made, clip)
        tasks = self.tasks if made.task in self.tasks else [*self.tasks, made.task]
        begin = int(self.records[-1]["dataset_to_index"]) if self.records else 0
        with files.temporary_folder(self.folder) as work:
            record = made.write(work, number, begin, tasks.index(made.task), {"clip": clip, "split": split})
            for path in filter(Path.is_file, sorted(work.rglob("*"))):
                place = path.relative_to(work)
                path.replace(files.folder_inside(self.folder, *place.parent.parts) / place.name)
        self.records.append(record)
        write_meta(self.folder, made, tasks, self.statistics(), self.splits, int(str(record["dataset_to_index"])))
        self.tasks, self.info = tasks, {"fps": made.fps, "features": made.features}
        return number

    def _check(self, made: Episode, clip: str) -> None:
        """Raise ``InputError`` for an episode whose rate or features differ from the dataset's, with the difference."""
        if not self.info:
            return
        own = "; a dataset of its own (another --out) takes it"
        if (fps := self.info["fps"]) != made.fps:
            expected = f"{fps}, as of the dataset's other episodes: --fps {fps} resamples it{own}"
            raise InputError(Path(clip), "", f"{made.fps} frames per second", expected)
        theirs, others = self.info["features"], "the other episodes have"
        missing, more = sorted({*theirs} - {*made.features}), sorted({*made.features} - {*theirs})
        if missing or more:
            named = (("no", missing), ("also", more))
            got = " and ".join(f"{word} {', '.join(some[:4])}" for word, some in named if some)
            raise InputError(Path(clip), "", got, f"what {others}{own}")
        other = next((name for name, feature in theirs.items() if feature != made.features[name]), None)
        if other is not None:
            shapes = (dict(one[other])["shape"] for one in (cast("Json", made.features), theirs))
            got, expected = (" x ".join(map(str, shape)) for shape in shapes)
            raise InputError(Path(clip), other, got, f"{expected}, as {others}{own}")

    @property
    def splits(self) -> dict[str, str]:
        """The ranges of episodes of each split, for ``info.json``."""
        ranges: dict[str, list[str]] = {"train": []}
        for split, run in groupby(range(len(self.records)), key=lambda n: str(self.records[n].get("split", "train"))):
            episodes = list(run)
            ranges.setdefault(split, []).append(f"{episodes[0]}:{episodes[-1] + 1}")
        return {split: ",".join(each) for split, each in ranges.items() if each}

    def statistics(self) -> dict[str, dict[str, ndarray]]:
        """Combine the statistics of all episodes, as LeRobot does: quantiles are means of the episodes' quantiles."""
        each: dict[str, dict[str, ndarray]] = {}
        for key in (key for key in self.records[0] if key.startswith("stats/")):
            _, name, statistic = key.split("/")
            each.setdefault(name, {})[statistic] = np.array([np.asarray(one[key]) for one in self.records])
        return {name: _merge_statistics(of_name) for name, of_name in each.items()}


def _check_info(path: Path, info: Json) -> None:
    """Raise ``InputError`` for an ``info.json`` that ``write_meta`` did not write."""
    for key, kind in {"fps": int, "total_episodes": int, "features": dict}.items():
        if type(info.get(key)) is not kind or (kind is int and info[key] < (key == "fps")):
            got = files.shorten_value(info[key]) if key in info else "no such key"
            raise InputError(path, key, got, "as this program wrote it")
    for name, feature in info["features"].items():
        sides = feature.get("shape") if isinstance(feature, dict) else None
        if not isinstance(sides, list) or not all(type(side) is int for side in sides) or "dtype" not in feature:
            key, got = f"features.{files.printable(name)}", files.shorten_value(feature)
            raise InputError(path, key, got, "its dtype and shape")


def _check_record(path: Path, record: Json, features: Json, number: int, begin: int) -> None:
    """Raise ``InputError`` for a record that does not fit the dataset and the first frame ``begin``."""
    length, tasks = record.get("length"), record.get("tasks")
    if type(length) is not int or length < 1:
        raise InputError(path, "length", files.shorten_value(length), "the episode's frames")
    known = {"episode_index": number, "dataset_from_index": begin, "dataset_to_index": begin + length}
    for key, value in known.items():
        if record.get(key) != value:
            raise InputError(path, key, files.shorten_value(record.get(key)), str(value))
    if not isinstance(tasks, list) or not all(isinstance(task, str) for task in tasks):
        raise InputError(path, "tasks", files.shorten_value(tasks), "texts")
    for name, feature in features.items():
        whole = (3, 1, 1) if feature["dtype"] == "video" else (math.prod(feature["shape"]),)
        for of in STATISTIC_NAMES if feature["dtype"] != "string" else ():
            key, shape = f"stats/{name}/{of}", (1,) if of == "count" else whole
            found = np.asarray(record.get(key))
            if found.dtype.kind not in "iuf" or found.shape != shape or not np.isfinite(found).all():
                got = "no such key" if key not in record else f"{found.dtype} of shape {found.shape}"
                raise InputError(path, key, got, f"numbers of shape {shape}")


def _merge_statistics(each: dict[str, ndarray]) -> dict[str, ndarray]:
    """Merge statistics (N, ...) of N episodes."""
    count = each["count"].reshape(len(each["count"]), *[1] * (each["mean"].ndim - 1))
    share = count / count.sum()
    mean = (share * each["mean"]).sum(axis=0)
    variance = (share * (each["std"] ** 2 + (each["mean"] - mean) ** 2)).sum(axis=0)
    known = {"min": each["min"].min(axis=0), "max": each["max"].max(axis=0), "mean": mean, "std": np.sqrt(variance)}
    quantiles = {key: (share * value).sum(axis=0) for key, value in each.items() if key.startswith("q")}
    return {**known, "count": each["count"].sum(axis=0), **quantiles}
