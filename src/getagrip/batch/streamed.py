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

from getagrip.batch.job import Job, Outcome, Progress, failure, reconstruct_one
from getagrip.clip import read_name
from getagrip.errors import InputError
from getagrip.io import files, leftovers
from getagrip.io.storage import ARCHIVE, Place, Remote

if TYPE_CHECKING:
    from getagrip.fitting.options import Options

LEFT_OUT = ("frames", "truth.npz")
"""Files of a clip that no reconstruction reads (``clip.input_sha256``)."""
RECORD, POSES = "result.json", "result.npz"
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
        with leftovers.workplace(_temporary()) as folder:
            outcome = _reconstructed(job, folder, progress)
            message = outcome.message
            for here, there in (("clip", job.clip), ("result", job.out)):
                message = message.replace(str(folder / here / job.name), str(there))
            return replace(outcome, message=message)
    except Exception as error:  # a full disk
        return failure(job.name, error)


@cache
def _temporary() -> Path:
    """Return the folder of temporary files, freed of what killed processes have left there."""
    folder = Path(tempfile.gettempdir())
    leftovers.sweep(folder)
    return folder


def _reconstructed(job: StreamedJob, folder: Path, progress: Progress | None) -> Outcome:
    """Return the outcome, whose message has names in the temporary folder."""
    try:
        clip, out = _clip(job, folder), _result(job, folder)
        there = out.exists()
        local = Job(job.name, clip, out, job.options, job.overwrite, str(job.clip), job.threads)
        outcome = reconstruct_one(local, progress)
        if outcome.state == "done" and isinstance(job.out, Remote):
            _send(out, job.out, replaces=there)
        return outcome
    except Exception as error:  # one clip's trouble must not end the others
        return failure(job.name, error)


def _clip(job: StreamedJob, folder: Path) -> Path:
    """Copy the clip to this machine. Raises ``InputError`` where it has another name than its folder in the store."""
    if isinstance(job.clip, Path):
        return job.clip
    clip = folder / "clip" / job.name
    clip.mkdir(parents=True)
    if job.clip.name.endswith(ARCHIVE):
        job.clip.unpack_to(clip, LEFT_OUT)
    else:
        job.clip.copy_to(clip, LEFT_OUT)
    name = read_name(clip)
    if name != job.name:
        expected = f"{job.name}, as its folder or archive is named"
        raise InputError(clip / "clip.json", "name", f"the name {files.shown(name)}", expected)
    return clip


def _result(job: StreamedJob, folder: Path) -> Path:
    """Return the result's folder on this machine, with the existing files of the result."""
    if isinstance(job.out, Path):
        return job.out
    out = folder / "result" / job.name
    out.parent.mkdir()
    record = (job.out / RECORD).read(files.LARGEST_JSON)
    if record is not None:
        poses = (job.out / POSES).read(files.LARGEST_FILE)
        out.mkdir()
        (out / RECORD).write_bytes(record)
        (out / POSES).write_bytes(poses or b"")
    return out


def _send(result: Path, out: Remote, replaces: bool) -> None:
    """Copy a result into the store. What is there is no result from the first step to the last."""
    if replaces:
        (out / RECORD).remove()
    for name in (POSES, RECORD):
        (out / name).write((result / name).read_bytes())


@contextmanager
def readable(out: Place, names: Sequence[str]) -> Iterator[Path]:
    """Copy some results to a folder on this machine, where they can be read."""
    if isinstance(out, Path):
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="getagrip.") as folder:
        for name in (RECORD, POSES):
            out.fetch([f"{result}/{name}" for result in names], files.LARGEST_JSON, Path(folder))
        yield Path(folder)
