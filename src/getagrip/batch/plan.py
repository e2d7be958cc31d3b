"""Which clips a call is about: what paths and patterns stand for, by name, and a shard's part of them."""

from __future__ import annotations

import glob
import os
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

from getagrip.batch.job import Outcome, failure
from getagrip.clip import read_name
from getagrip.errors import InputError, UsageError


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of all clips, by their names: which one a clip is in depends on nothing else."""

    index: int = 1
    """1 to ``count``."""
    count: int = 1

    @classmethod
    def of(cls, text: str) -> Shard:
        """From "i/N". Raises ``UsageError``."""
        index, slash, count = text.partition("/")
        if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
            raise UsageError(f"--shard: got {text}, expected i/N with i from 1 to N, such as 2/4")
        return cls(int(index), int(count))

    def __contains__(self, name: str) -> bool:
        return crc32(name.encode()) % self.count == self.index - 1


ALL = Shard()
"""Every clip."""


class Plan:
    """The clips of a call in the order in which they were found: on disk, since there may be millions."""

    def __init__(self, paths: Sequence[Path], shard: Shard = ALL) -> None:
        """Find them. Raises ``UsageError`` where two clips have the same name: their results would have, too."""
        self.failed: list[Outcome] = []
        """Paths that are no clips."""
        self._db = sqlite3.connect("")  # a temporary file, and that only where it does not fit into the cache
        self._db.execute("CREATE TABLE clips (place INTEGER PRIMARY KEY, name TEXT UNIQUE, folder BLOB)")
        for name, clip in _named_clips(paths, self.failed):
            if name not in shard:
                continue
            try:
                self._db.execute("INSERT INTO clips (name, folder) VALUES (?, ?)", (name, os.fsencode(clip)))
            except sqlite3.IntegrityError:
                (other,) = self._db.execute("SELECT folder FROM clips WHERE name = ?", (name,)).fetchone()
                self._db.close()
                raise UsageError(
                    f"{clip} and {os.fsdecode(other)} are both named {name!r}; give one at a time"
                ) from None

    def __len__(self) -> int:
        (count,) = self._db.execute("SELECT count(*) FROM clips").fetchone()
        return int(count)

    def __iter__(self) -> Iterator[tuple[str, Path]]:
        """The name and the folder of each."""
        for name, folder in self._db.execute("SELECT name, folder FROM clips ORDER BY place"):
            yield name, Path(os.fsdecode(folder))

    def __enter__(self) -> Plan:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()


def by_name(paths: Sequence[Path]) -> tuple[dict[str, Path], list[Outcome]]:
    """The folder of each clip by its name, and the outcome of those that have none.

    A path is a clip, a folder of clips, or a pattern. Raises ``UsageError`` as ``Plan`` does.
    """
    with Plan(paths) as plan:
        return dict(plan), plan.failed


def _named_clips(paths: Sequence[Path], failed: list[Outcome]) -> Iterator[tuple[str, Path]]:
    """The name and the folder of each clip; paths that are none go to ``failed``."""
    for path in paths:
        try:
            for clip in clips_in(path):
                try:
                    yield read_name(clip), clip
                except InputError as error:
                    failed.append(failure(clip.name, error))
        except (InputError, OSError) as error:
            failed.append(failure("", error))


def clips_in(path: Path) -> Iterator[Path]:
    """The clip folders that a path stands for. Raises ``InputError`` where it holds none."""
    if path.name == "clip.json" or (path / "clip.json").exists():
        yield path.parent if path.name == "clip.json" else path
        return
    if not path.exists() and glob.has_magic(str(path)):
        folders, lack = sorted(glob.iglob(str(path), recursive=True)), "a pattern that no clip matches"
    elif path.is_dir():
        folders, lack = [str(path)], "no clip.json in it or in its folders"
    else:
        raise InputError(path, "", "no such folder", "a clip, or a folder of clips")
    found = False
    for folder in folders:
        for clip in _in_folder(Path(folder)):
            yield clip
            found = True
    if not found:
        raise InputError(path, "", lack, "a clip, or a folder of clips")


def _in_folder(path: Path) -> Iterator[Path]:
    """The clip that a folder is, or those in it, sorted."""
    if (path / "clip.json").exists():
        yield path
    elif path.is_dir():
        yield from (path / name for name in sorted(os.listdir(path)) if (path / name / "clip.json").exists())
