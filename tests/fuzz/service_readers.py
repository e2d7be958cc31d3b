"""What other programs answer and ask: listings and objects of a store, requests of the annotation page."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import make_archive
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pytest

from fuzz.child import SHARED, Reader
from getagrip.batch.clips import ClipPlan
from getagrip.batch.job import UNREAD_CLIP_FILES
from getagrip.clip import read_clip, write_clip
from getagrip.errors import GetagripError, UsageError
from getagrip.io import files
from getagrip.io.storage import RemotePath
from getagrip.studio.project import Project
from getagrip.studio.server import CHANGE_ROUTES
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.tasks import Task
from helpers.clips import small_clip

CLIPS = RemotePath("s3://bucket/clips")


class AnsweringStore:
    """A store that answers whatever a file says."""

    def __init__(self, answers: dict[str, Any]) -> None:
        self.answers = answers

    def ls(self, path: str, detail: bool) -> Any:
        return self.answers["ls"]

    def glob(self, path: str) -> Any:
        return self.answers["glob"]

    def find(self, path: str, detail: bool) -> Any:
        return self.answers["find"]

    def unstrip_protocol(self, path: str) -> str:
        return f"s3://{path}"

    def cat_ranges(self, paths: list[str], starts: list[int], ends: list[int], on_error: str) -> Any:
        return [bytes(min(end, 100)) if self.answers["size"] is None else bytes(self.answers["size"]) for end in ends]


def a_listing(folder: Path) -> None:
    """Of a folder of two clips, and of one of them."""
    entries = [{"name": f"bucket/clips/{name}", "size": 0, "type": "directory"} for name in ("a", "b")]
    names = ("clip.json", "hand.npz", "masks/object/0001.png", "images/0001.jpg")
    found = {f"bucket/clips/a/{name}": {"name": f"bucket/clips/a/{name}", "size": 3, "type": "file"} for name in names}
    answers = {"ls": entries, "glob": ["bucket/clips/a"], "find": found, "size": 3}
    (folder / "answers.json").write_text(json.dumps(answers))


def use_listing(folder: Path) -> None:
    """What a batch does with it."""
    store = AnsweringStore(files.read_json(folder / "answers.json"))
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory(dir=SHARED) as out:
        patch.setattr(RemotePath, "_opened", lambda self: (store, self.url.removeprefix("s3://")))
        for address in (CLIPS, RemotePath(f"{CLIPS}/*")):
            with ClipPlan([address]) as plan:
                list(plan)
        inside = Path(out) / "in"
        inside.mkdir()
        (CLIPS / "a").copy_to(inside, UNREAD_CLIP_FILES)
        assert [path.name for path in Path(out).iterdir()] == ["in"]


def packed(folder: Path) -> None:
    """A clip as one object."""
    with TemporaryDirectory(dir=SHARED) as out:
        clip = write_clip(*small_clip(), Path(out) / "small")
        make_archive(str(folder / "small"), "zip", clip)


def use_packed(folder: Path) -> None:
    """What a batch does with it."""
    content = files.read_bytes(folder / "small.zip", 2**24)
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory(dir=SHARED) as out:
        patch.setattr(RemotePath, "read", lambda self, limit: content)
        inside = Path(out) / "in"
        inside.mkdir()
        try:
            RemotePath("s3://bucket/clips/small.zip").unpack_to(inside, UNREAD_CLIP_FILES)
            read_clip(inside)
        finally:
            assert [path.name for path in Path(out).iterdir()] == ["in"]


def requests(folder: Path) -> None:
    """Of somebody who marks a grasp, labels a frame of it, and takes that back."""
    who = {"task": "t", "annotator": "ann", "tab": "tab-0000"}
    joints = {"0": [10, 20], "5": "unseen"}
    outline = {"of": "object", "closed": True, "points": [[1, 1], [1, 5], [5, 5]]}
    mark, grasp = {**who, "mark": "mark-000"}, {**who, "grasp": "mark-000"}
    marked = {"start": 0, "end": 1, "side": "left", "category": "cup"}
    asked = [
        ("/api/change", {**mark, "change": "change-1", "set": marked}),
        (
            "/api/label",
            {**grasp, "change": "change-2", "frame": 1, "set": {"joints": joints, "outlines": {"outline-1": outline}}},
        ),
        ("/api/unlabel", {**grasp, "change": "change-3"}),
        ("/api/undo", {**who, "change": "change-4"}),
    ]
    (folder / "requests.jsonl").write_text("\n".join(json.dumps({"path": path, "content": it}) for path, it in asked))


def answer(folder: Path) -> None:
    """What the server's handler does with them, and the page's own questions."""
    try:
        lines = [json.loads(line) for line in files.read_bytes(folder / "requests.jsonl", 2**20).splitlines()]
    except (ValueError, RecursionError) as error:
        raise UsageError("invalid JSON") from error
    images = SHARED / "footage"
    if not images.exists():
        images.mkdir()
        for n in range(2):
            cv2.imwrite(str(images / f"{n}.png"), np.full((48, 64, 3), n, np.uint8))
    refused = None
    with TemporaryDirectory(dir=SHARED) as out:
        project = Project([Task("t", "t", images)], Store(Path(out) / "marks.sqlite"))
        for line in lines:
            try:
                path, content = (line.get("path"), line.get("content")) if isinstance(line, dict) else (None, None)
                if isinstance(content, dict) and isinstance(path, str) and path in CHANGE_ROUTES:
                    json.dumps(getattr(project, CHANGE_ROUTES[path])(content), allow_nan=False)
                    project.marks("t", "ann")
                    if "grasp" in content:
                        project.labels_file(content)
            except GetagripError as error:
                refused = error
        project.close()
    if refused is not None:
        raise refused


READERS: dict[str, Reader] = {
    "listing": Reader(a_listing, use_listing),
    "packed clip": Reader(packed, use_packed),
    "requests": Reader(requests, answer),
}
"""By name."""
