"""One clip in an object store: copied to this machine, reconstructed, and its result copied back.

A result is written with its ``result.json`` last, and without that it is none: half of one is never taken for done.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.batch.job import Job, Outcome, Progress, failed_outcome, reconstruct_one
from getagrip.clip import read_name
from getagrip.errors import InputError
from getagrip.io import files, leftovers
from getagrip.io.storage import ARCHIVE_SUFFIX, Place, RemotePath

if TYPE_CHECKING:
    from getagrip.fitting.options import Options

UNREAD_CLIP_FILES = ("frames", "truth.npz")
"""Files of a clip that no reconstruction reads (``clip.input_sha256``)."""
RESULT_RECORD_FILE, RESULT_POSES_FILE = "result.json", "result.npz"
"""Files of a result; the first marks a folder as one."""


@dataclass(frozen=True)
class StreamedJob:
    """A clip to reconstruct that, or whose result, lies in an object store."""

    name: str
    clip: Place
    out: Place
    """The result's own folder."""
    options: Options
    overwrite: bool
    threads: int = 1
    """That share the hypotheses."""


def reconstruct_streamed(job: StreamedJob, progress: Progress | None = None) -> Outcome:
    """Reconstruct one clip as ``reconstruct_one`` does.

    What is in a store is copied to a temporary folder before, and the result is copied back after.
    """
    try:
        with leftovers.temporary_folder(_temporary_folder()) as folder:
            outcome = _reconstruct_local_copy(job, folder, progress)
            message = outcome.message
            for here, there in (("clip", job.clip), ("result", job.out)):
                message = message.replace(str(folder / here / job.name), str(there))
            return replace(outcome, message=message)
    except Exception as error:  # a full disk
        return failed_outcome(job.name, error)


@cache
def _temporary_folder() -> Path:
    """Return the folder of temporary files, freed of what killed processes have left there."""
    folder = Path(tempfile.gettempdir())
    leftovers.remove_stale_folders(folder)
    return folder


def _reconstruct_local_copy(job: StreamedJob, folder: Path, progress: Progress | None) -> Outcome:
    """Return the outcome, whose message has names in the temporary folder."""
    try:
        clip, out = _fetch_clip(job, folder), _fetch_result(job, folder)
        there = out.exists()
        local = Job(job.name, clip, out, job.options, job.overwrite, str(job.clip), job.threads)
        outcome = reconstruct_one(local, progress)
        if outcome.state == "done" and isinstance(job.out, RemotePath):
            _upload_result(out, job.out, replaces=there)
        return outcome
    except Exception as error:  # one clip's trouble must not end the others
        return failed_outcome(job.name, error)


def _fetch_clip(job: StreamedJob, folder: Path) -> Path:
    """Copy the clip to this machine. Raises ``InputError`` where it has another name than its folder in the store."""
    if isinstance(job.clip, Path):
        return job.clip
    clip = folder / "clip" / job.name
    clip.mkdir(parents=True)
    if job.clip.name.endswith(ARCHIVE_SUFFIX):
        job.clip.unpack_to(clip, UNREAD_CLIP_FILES)
    else:
        job.clip.copy_to(clip, UNREAD_CLIP_FILES)
    name = read_name(clip)
    if name != job.name:
        expected = f"{job.name}, as its folder or archive is named"
        raise InputError(clip / "clip.json", "name", f"the name {files.shorten_value(name)}", expected)
    return clip


def _fetch_result(job: StreamedJob, folder: Path) -> Path:
    """Return the result's folder on this machine, with the existing files of the result."""
    if isinstance(job.out, Path):
        return job.out
    out = folder / "result" / job.name
    out.parent.mkdir()
    record = (job.out / RESULT_RECORD_FILE).read(files.MAX_JSON_BYTES)
    if record is not None:
        poses = (job.out / RESULT_POSES_FILE).read(files.MAX_FILE_BYTES)
        out.mkdir()
        (out / RESULT_RECORD_FILE).write_bytes(record)
        (out / RESULT_POSES_FILE).write_bytes(poses or b"")
    return out


def _upload_result(result: Path, out: RemotePath, replaces: bool) -> None:
    """Copy a result into the store. What is there is no result from the first step to the last."""
    if replaces:
        (out / RESULT_RECORD_FILE).remove()
    for name in (RESULT_POSES_FILE, RESULT_RECORD_FILE):
        (out / name).write((result / name).read_bytes())


@contextmanager
def local_results(out: Place, names: Sequence[str]) -> Iterator[Path]:
    """Copy some results to a folder on this machine, where they can be read."""
    if isinstance(out, Path):
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="getagrip.") as folder:
        for name in (RESULT_RECORD_FILE, RESULT_POSES_FILE):
            out.fetch([f"{result}/{name}" for result in names], files.MAX_JSON_BYTES, Path(folder))
        yield Path(folder)
