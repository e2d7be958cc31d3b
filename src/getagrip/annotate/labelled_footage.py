"""The footage of a file of labels, recognised by its checksum or, without one, by its name."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from getagrip.annotate.labels import Labels
from getagrip.annotate.tasks import Task
from getagrip.annotate.versions import RefusedError
from getagrip.io import files


def footage_checksum(path: Path) -> str:
    """Compute the checksum of a video file; of a folder of images, that of their names and contents.

    Raises ``OSError``.
    """
    found = files.list_files(path) if path.is_dir() else [path]
    return _cached_checksum(
        tuple((each, each.stat().st_size, each.stat().st_mtime_ns) for each in found), path.is_dir()
    )


@lru_cache(maxsize=8)
def _cached_checksum(known: tuple[tuple[Path, int, int], ...], folder: bool) -> str:
    """Return the checksum of files whose sizes and times are unchanged."""
    total = hashlib.sha256()
    for path, size, _ in known:
        if folder:
            total.update(f"{path.name}\0{size}\0".encode())
        with path.open("rb") as stream:
            while part := stream.read(2**20):
                total.update(part)
    return total.hexdigest()


def tasks_of_labels(labels: Labels, tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks whose footage the labels are of, whatever its name is now; that of their name is tried first.

    Raises ``RefusedError`` where there is none.
    """
    there = [(task, task.path) for task in tasks if task.path is not None]
    named = [(task, path) for task, path in there if path.name == labels.video]
    name = files.printable(labels.video)
    if not labels.sha256:
        if not named:
            raise RefusedError(
                f"video must be the name of a video that is given here (got {name} and no checksum of it)"
            )
        return [task for task, _ in named]
    for some in (named, there):
        same = [task for task, path in some if footage_checksum(path) == labels.sha256]
        if same:
            return same
    if named:
        raise RefusedError(
            f"sha256: {name} here is another file than the one that was labelled; if its frames are the same ones, "
            "take the key sha256 out of the labels"
        )
    raise RefusedError(f"missing footage of {name}: none has this name or checksum")
