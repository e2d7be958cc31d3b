"""Which clips a call is about: what paths and patterns stand for, by name, and a shard's part of them."""

from __future__ import annotations

import glob
import os
import sqlite3
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from getagrip.batch.job import Outcome, failed_outcome
from getagrip.batch.share import WHOLE_SHARD, Shard
from getagrip.clip import read_name
from getagrip.errors import GetagripError, InputError, UsageError, escape_unprintable
from getagrip.io import files
from getagrip.io.storage import ARCHIVE_SUFFIX, Place, RemotePath, parse_place

RESERVED_NAMES = ("index.html", "summary.csv", "ledger.sqlite", "ledger.sqlite-wal", "ledger.sqlite-shm", "clips")
"""Files beside the results in their folder: no clip may have these names."""
FOLDS_CASE = sys.platform in ("win32", "darwin")
"""True where names that differ in the case of letters only are, as a rule, of one file."""


class ClipPlan:
    """The clips of a call in the order in which they were found: on disk, since there may be millions."""

    def __init__(self, paths: Sequence[Place], shard: Shard = WHOLE_SHARD) -> None:
        """Find them; a clip that is named twice counts once."""
        self.failed: list[Outcome] = []
        """Paths that are no clips, and clips that share their name with another, as their results would."""
        self.remote = any(isinstance(path, RemotePath) for path in paths)
        """True if some lie in an object store."""
        self._db = sqlite3.connect("")  # a temporary file, and that only where it does not fit into the cache
        self._db.execute("CREATE TABLE found (place INTEGER PRIMARY KEY, name TEXT, file TEXT, folder BLOB)")
        for name, clip in _named_clips(paths, self.failed):
            if name not in shard:
                continue
            if name in RESERVED_NAMES:
                known = InputError(
                    str(clip), "name", files.shorten_value(name), f"another name; {', '.join(RESERVED_NAMES)} are taken"
                )
                self.failed.append(_path_failure(name, clip, known))
                continue
            row = (name, name.casefold() if FOLDS_CASE else name, os.fsencode(str(clip)))
            self._db.execute("INSERT INTO found (name, file, folder) VALUES (?, ?, ?)", row)
        self._db.execute("CREATE INDEX by_file ON found (file)")
        self._sort_out_namesakes()

    def _sort_out_namesakes(self) -> None:
        """Leave each clip once, and of clips that share a name none."""
        shared = "SELECT file, min(name) FROM found GROUP BY file HAVING count(*) > 1"
        for file, name in self._db.execute(shared).fetchall():
            clips = dict[Place, tuple[int, Place]]()
            for n, folder in self._db.execute("SELECT place, folder FROM found WHERE file = ? ORDER BY place", (file,)):
                clip = parse_place(os.fsdecode(folder))
                clips.setdefault(_resolved(clip), (n, clip))
            (kept, first), *others = clips.values()
            self._db.execute("DELETE FROM found WHERE file = ? AND (? OR place != ?)", (file, bool(others), kept))
            alike = [clip for _, clip in others]
            for clip, other in zip([first, *alike], [*alike[:1], *[first] * len(alike)], strict=False):
                expected = f"a name of its own: {other} has the same, and so would their results"
                error = InputError(str(clip), "name", files.shorten_value(name), expected)
                self.failed.append(_path_failure(name, clip, error))

    def __len__(self) -> int:
        (count,) = self._db.execute("SELECT count(*) FROM found").fetchone()
        return int(count)

    def __iter__(self) -> Iterator[tuple[str, Place]]:
        """Yield the name and the folder of each."""
        for name, folder in self._db.execute("SELECT name, folder FROM found ORDER BY place"):
            yield name, parse_place(os.fsdecode(folder))

    def __enter__(self) -> ClipPlan:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()


def clips_by_name(paths: Sequence[Path]) -> tuple[dict[str, Path], list[Outcome]]:
    """Return the folder of each clip by its name, and the outcome of those that have none.

    A path is a clip, a folder of clips, or a pattern; of clips that share a name, each has failed.
    """
    with ClipPlan(paths) as plan:
        return {name: clip for name, clip in plan if isinstance(clip, Path)}, plan.failed


def _path_failure(name: str, clip: Place, error: Exception) -> Outcome:
    """Make the outcome of a path that gives no clip to work on."""
    whole = clip.absolute() if isinstance(clip, Path) else clip
    return replace(failed_outcome(name, error), path=escape_unprintable(str(whole)))


def _resolved(clip: Place) -> Place:
    return clip.resolve() if isinstance(clip, Path) else clip


def _named_clips(paths: Sequence[Place], failed: list[Outcome]) -> Iterator[tuple[str, Place]]:
    """Yield the name and the folder of each clip; paths that are none go to ``failed``."""
    for path in paths:
        try:
            if isinstance(path, RemotePath):
                yield from _clips_in_store(path, failed)
                continue
            for clip in clips_in(path):
                try:
                    yield read_name(clip), clip
                except InputError as error:
                    failed.append(_path_failure(clip.name, clip, error))
        except (InputError, OSError) as error:
            failed.append(_path_failure("", path, error))


def clips_in(path: Path) -> Iterator[Path]:
    """Yield the clip folders that a path stands for. Raises ``InputError`` where it holds none."""
    if path.name == "clip.json" or (path / "clip.json").exists():
        yield path.parent if path.name == "clip.json" else path
        return
    if not path.exists() and glob.has_magic(str(path)):
        folders, lack = sorted(glob.iglob(str(path), recursive=True)), "a pattern that no clip matches"
    elif path.is_dir():
        folders, lack = [str(path)], "no clip.json in it or in its folders"
    elif path.suffix == ARCHIVE_SUFFIX and path.is_file():
        address = f"local://{path.absolute()}"
        expected = f"a clip, or a folder of clips; reconstruct reads archives at addresses only, this one at {address}"
        raise InputError(path, "", "an archive", expected)
    else:
        raise InputError(path, "", "no such folder", "a clip, or a folder of clips")
    found = False
    for folder in folders:
        for clip in _clips_in_folder(Path(folder)):
            yield clip
            found = True
    if not found:
        raise InputError(path, "", lack, "a clip, or a folder of clips")


def _clips_in_store(path: RemotePath, failed: list[Outcome]) -> Iterator[tuple[str, RemotePath]]:
    """Yield the clips that an address stands for: one, the folders in it, or those that match it.

    No clip is read yet.

    A clip has its folder's or archive's name there, since reading all names takes long.
    """
    try:
        found = _folders_in_store(path)
    except UsageError:
        raise
    except GetagripError as error:  # the whole store is out of reach
        raise UsageError(f"CLIP: {error}") from error
    if not found:
        raise InputError(path.url, "", "no folder or archive in it", "a clip, a folder of clips, or a pattern")
    for clip in found:
        name = clip.name.removesuffix(ARCHIVE_SUFFIX)
        if files.is_portable_name(name):
            yield name, clip
        else:
            wrong = InputError(
                clip.url, "", f"the name {files.shorten_value(clip.name)}", "a name that can name a folder"
            )
            failed.append(_path_failure("", clip, wrong))


def _folders_in_store(path: RemotePath) -> list[RemotePath]:
    """List the folders and archives that may be clips."""
    if glob.has_magic(path.url):
        return path.matches()
    if path.name.endswith(ARCHIVE_SUFFIX):
        return [path]
    if path.name == "clip.json":
        return [path.parent]
    there = path.children()
    if ("clip.json", False) in there:
        return [path]
    return [path / name for name, is_folder in there if is_folder or name.endswith(ARCHIVE_SUFFIX)]


def _clips_in_folder(path: Path) -> Iterator[Path]:
    """Yield the clip that a folder is, or those in it, sorted."""
    if (path / "clip.json").exists():
        yield path
    elif path.is_dir():
        yield from (path / name for name in sorted(os.listdir(path)) if (path / name / "clip.json").exists())
