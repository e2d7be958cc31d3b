"""Lists of candidates are checked, and their footage is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from getagrip.studio.store.tasks import open_footage, read_tasks
from helpers.labelled_scene import write_images, write_video

ROWS: dict[str, list[dict[str, Any]]] = {
    "own": [{"video": "a", "start": 5, "end": 30, "side": "left", "category": "mug"}],
    "table": [
        {
            "vid": "P01_01", "st_bound": 5, "ed_bound": 30, "contact": 12, "handside": "left hand", "cat": "mug",
            "hos_name": "red mug", "mp4_name": "P01_01_5_12_30_left_mug.mp4",
        }
    ],
    "epic": [
        {
            "video": "P01_01", "side": "left", "category": "mug", "entity": "red mug", "contacts": [12, 20],
            "start_bound": 5, "end_bound": 30, "narrations": [], "seconds": 1.0, "name": "P01_01_5_12_20_30_left_mug",
        }
    ],
}  # fmt: skip


def written(path: Path, rows: list[dict[str, Any]]) -> Path:
    if path.suffix == ".json":
        path.write_text(json.dumps(rows))
    else:
        path.write_text("\n".join([",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)]))
    return path


@pytest.mark.parametrize(("kind", "suffix"), [("own", "csv"), ("own", "json"), ("table", "csv"), ("epic", "json")])
def test_lists_of_candidates(tmp_path: Path, kind: str, suffix: str) -> None:
    rows = ROWS[kind]
    video = rows[0].get("vid") or rows[0]["video"]
    path = write_video(tmp_path / f"{video}.mp4", fps=30 if kind == "own" else 60)
    (task,) = read_tasks(written(tmp_path / f"list.{suffix}", rows))
    assert (task.path, task.start, task.end, task.side, task.category) == (path, 5, 30, "left", "mug")
    assert task.extent(open_footage(path)) == (4, 29)
    if kind != "own":
        assert task.contact == 12
        assert task.entity == "red mug"
        assert task.mp4_name == f"{task.key}.mp4"


def test_a_video_is_found_where_epic_has_it(tmp_path: Path) -> None:
    images = write_images(tmp_path / "root" / "P01" / "rgb_frames" / "P01_01", [5, 6])
    source = written(tmp_path / "list.csv", ROWS["table"])
    assert read_tasks(source, tmp_path / "root")[0].path == images
    video = tmp_path / "root" / "P01" / "videos" / "P01_01.MP4"
    video.parent.mkdir()
    video.touch()
    assert read_tasks(source, tmp_path / "root")[0].path == video


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"video": "../a"}, "video"),
        ({"start": -1}, "start"),
        ({"start": "five"}, "start"),
        ({"start": 40}, "end"),
        ({"end": 10**12}, "end"),
        ({"side": "both"}, "side"),
        ({"category": ""}, "category"),
        ({"category": 3}, "category"),
        ({"start": True}, "start"),
        ({"mp4_name": "../x.mp4"}, "mp4_name"),
    ],
)
def test_bad_candidates_are_refused(
    tmp_path: Path, refused: Callable[..., str], change: dict[str, Any], words: str
) -> None:
    (tmp_path / "a.mp4").touch()
    path = written(tmp_path / "list.json", [ROWS["own"][0] | change])
    refused(lambda: read_tasks(path), "list.json: [0].", words)


def test_bad_lists_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "a.mp4").touch()
    path = tmp_path / "list.json"
    for text in ("{", "{}", "[]", "[1]", "[" * 100_000, '[{"a": 1}]'):
        path.write_text(text)
        refused(lambda: read_tasks(path), "list.json")
    written(path, ROWS["own"] * 2)
    refused(lambda: read_tasks(path), "twice")
    table = tmp_path / "list.csv"
    for text in ("", "a,b\n1\n", "vid,vid\na,b\n", "video,start,end,side,category\na,1,2,left\n"):
        table.write_text(text)
        refused(lambda: read_tasks(table), "list.csv")
    (tmp_path / "a.mp4").unlink()
    refused(lambda: read_tasks(path.with_name("absent.json")), "no such file")
    written(path, ROWS["own"])
    refused(lambda: read_tasks(path), "no footage")


def test_a_candidate_beyond_its_footage_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = write_video(tmp_path / "a.mp4")
    (task,) = read_tasks(written(tmp_path / "list.json", [ROWS["own"][0] | {"start": 500, "end": 600}]))
    refused(lambda: task.extent(open_footage(path)), "500")


def test_what_is_no_footage_is_refused_before_a_page_is_served(tmp_path: Path, refused: Callable[..., str]) -> None:
    for name, content in (("cut.mp4", b"\0\0\0\x20ftypisom"), ("README.md", b"# words")):
        (tmp_path / name).write_bytes(content)
        refused(lambda path=tmp_path / name: read_tasks(path), name)
    (tmp_path / "empty").mkdir()
    refused(lambda: read_tasks(tmp_path / "empty"), "empty must be ", "got 0 images")
