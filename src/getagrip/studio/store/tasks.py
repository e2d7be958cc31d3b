"""Annotation tasks: a video, a folder of images, or a list of candidates in several of them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from getagrip.errors import InputError
from getagrip.io.files import csv_rows, is_portable_name, printable, read_bytes, shorten_value
from getagrip.readers.datasets.epic.epic_tables import MAX_FRAME_NUMBER, subject_of
from getagrip.readers.datasets.epic.visor import SIDE_BY_HAND_NAME
from getagrip.readers.footage import Footage, ImageFolder, VideoFootage
from getagrip.readers.video import VIDEO_SUFFIXES

MAX_TASK_LIST_BYTES = 64 * 2**20
"""Maximum size of a list of candidates [bytes]."""
MAX_TASK_TEXT_LENGTH = 200
"""Maximum length of the name of a category or thing [characters]."""
TASK_COLUMNS = (
    ("video", "start", "end", "side", "category", "entity"),
    ("vid", "st_bound", "ed_bound", "handside", "cat", "hos_name"),
    ("video", "start_bound", "end_bound", "side", "category", "entity"),
)
"""Columns of a list: made by hand, EPIC-Grasps' table, the JSON of ``epic candidates``. The last column is optional."""


@dataclass(frozen=True)
class Task:
    """Footage, or an interval of it, in which an annotator marks stable grasps."""

    key: str
    """Unique name."""
    video: str
    path: Path | None
    """Path of the footage; None where it was not found."""
    start: int | None = None
    """Rough start and end, both included, in the footage's own frame numbers; None for all frames."""
    end: int | None = None
    side: str | None = None
    category: str | None = None
    entity: str | None = None
    """Name of the thing, as "olive oil bottle"."""
    contact: int | None = None
    """Number of a frame in which the hand is known to touch the object."""
    mp4_name: str | None = None
    """EPIC-Grasps' name of the candidate."""

    def extent(self, footage: Footage) -> tuple[int, int]:
        """Return the first and last frame, from 0. Raises ``InputError`` where the footage ends before ``start``."""
        if self.start is None or self.end is None:
            return 0, footage.frames - 1
        last = footage.number(footage.frames - 1)
        if self.start > last:
            expected = f"frame {self.start}, where {self.key} starts"
            raise InputError(self.path or self.video, "", f"frames up to {last}", expected)
        return footage.index(self.start), footage.index(self.end)


def open_footage(path: Path) -> Footage:
    """Open a video file or a folder of images. Raises ``InputError``."""
    return ImageFolder.open(path) if path.is_dir() else VideoFootage(path)


def read_tasks(source: Path, videos: Path | None = None) -> list[Task]:
    """Return one task for a video or a folder of images; for a list (.csv, .json) one for each candidate.

    ``videos`` is the folder of a list's footage, by default the list's own. Raises ``InputError`` for a malformed list,
    and for a source that is neither list nor footage.
    """
    if source.is_file() and source.suffix.lower() in (".csv", ".json"):
        tasks = [_parse_task(source, videos or source.parent, *row) for row in _read_task_rows(source)]
        twice = [key for key, count in Counter(task.key for task in tasks).items() if count > 1]
        if twice:
            raise InputError(source, "", f"the candidate {printable(twice[0])} twice", "each once")
        if all(task.path is None for task in tasks):
            got = f"no footage of its {len(tasks)} candidates in {videos or source.parent}"
            raise InputError(
                source, "", got, f"{printable(tasks[0].video)}.mp4, or a folder {printable(tasks[0].video)}"
            )
        return tasks
    if not source.exists():
        raise InputError(source, "", "no such file", "a video, a folder of images, or a list of candidates")
    open_footage(source).close()
    name = source.resolve().name if source.is_dir() else source.stem
    return [Task(name, name, source)]


def _parse_task(source: Path, videos: Path, where: str, named: Sequence[str], row: Mapping[str, object]) -> Task:
    """Parse a row of a list."""

    def text(key: str, expected: str) -> str:
        value = row.get(key)
        value = value.strip() if isinstance(value, str) else value
        if not isinstance(value, str) or not 0 < len(value) <= MAX_TASK_TEXT_LENGTH or not value.isprintable():
            raise InputError(source, f"{where}{key}", shorten_value(value), expected)
        return value

    def whole(key: str, least: int) -> int:
        value = row.get(key)
        if isinstance(value, str) and value.strip().isascii() and value.strip().removeprefix("-").isdigit():
            value = int(value) if len(value) <= 12 else None
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= MAX_FRAME_NUMBER:
            raise InputError(source, f"{where}{key}", shorten_value(row.get(key)), f"a whole number from {least}")
        return value

    video = text(named[0], "the name of a video")
    if not is_portable_name(video):
        raise InputError(source, f"{where}{named[0]}", shorten_value(video), "the name of a video, without folders")
    start = whole(named[1], 0)
    end = whole(named[2], start)
    side = text(named[3], "left or right")
    side = SIDE_BY_HAND_NAME.get(side, side)
    if side not in ("left", "right"):
        raise InputError(source, f"{where}{named[3]}", shorten_value(side), "left or right")
    category = text(named[4], "the name of a kind of objects")
    entity = text(named[5], "the name of a thing") if row.get(named[5]) else None
    contact = whole("contact", -1) if row.get("contact") not in (None, "") else -1
    name = row.get("mp4_name") or row.get("name") or None
    if name is not None and not (isinstance(name, str) and is_portable_name(name)):
        raise InputError(source, f"{where}mp4_name", shorten_value(name), "the name of a file")
    own = f"{video}_{start}_{end}_{side}_{category}" + (f"_{entity}" if entity else "")
    key, mp4_name = (name.removesuffix(".mp4"), f"{name.removesuffix('.mp4')}.mp4") if name else (own, None)
    touched = None if contact < 0 else contact
    return Task(key, video, _find_footage(videos, video), start, end, side, category, entity, touched, mp4_name)


def _find_footage(root: Path, video: str) -> Path | None:
    """Find a video's file or folder of frames, in the root folder or in the folders of EPIC-KITCHENS."""
    subject = root / subject_of(video)
    stem = Path(video).stem if Path(video).suffix in VIDEO_SUFFIXES else video
    files = (folder / f"{stem}{suffix}" for folder in (root, subject / "videos", subject) for suffix in VIDEO_SUFFIXES)
    folders = (folder / stem for folder in (subject / "rgb_frames", subject, root))
    return next((path for path in files if path.is_file()), next((path for path in folders if path.is_dir()), None))


def _read_task_rows(path: Path) -> Iterator[tuple[str, Sequence[str], Mapping[str, object]]]:
    """Yield each row of a list: its place, the names of its columns, and its cells. Raises ``InputError``."""
    content = read_bytes(path, MAX_TASK_LIST_BYTES)
    rows = _json_task_rows(path, content) if path.suffix.lower() == ".json" else _csv_task_rows(path, content)
    if not rows:
        raise InputError(path, "", "no candidates", "one at least")
    for where, row in rows:
        named = next((names for names in TASK_COLUMNS if {*names[:5]} <= row.keys()), None)
        if named is None:
            expected = " or ".join(", ".join(names[:5]) for names in TASK_COLUMNS)
            raise InputError(path, where.rstrip(". ,"), f"the columns {shorten_value(sorted(map(str, row)))}", expected)
        yield where, named, row


def _json_task_rows(path: Path, content: bytes) -> list[tuple[str, dict[str, object]]]:
    try:
        rows = json.loads(content)
    except (ValueError, RecursionError) as error:  # RecursionError: nested thousands deep
        raise InputError(path, "", f"invalid JSON ({error})", "a list of candidates") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(path, "", f"a JSON {type(rows).__name__}", "a list of candidates, each an object")
    for row in rows:  # `epic candidates` lists all contacts
        if isinstance(contacts := row.get("contacts"), list) and contacts:
            row["contact"] = contacts[0]
    return [(f"[{n}].", cast(dict[str, object], row)) for n, row in enumerate(rows)]


def _csv_task_rows(path: Path, content: bytes) -> Sequence[tuple[str, Mapping[str, object]]]:
    heads, rows = csv_rows(path, content, "a list of candidates in UTF-8")
    if len(set(heads)) < len(heads):
        raise InputError(path, "line 1", "a column twice", "each once")
    return rows
