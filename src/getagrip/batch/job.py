"""Reconstruct one clip, from its folder to its result's folder, within limits; errors become messages.

A clip in an object store is copied to this machine, and its result copied back. ``result.json`` is written last: a
folder without it is no result, so an interrupted copy never counts as done.
"""

from __future__ import annotations

import math
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from getagrip.batch.freshness import software_of_method, valid_result
from getagrip.clip import input_sha256, read_clip, read_name
from getagrip.errors import GetagripError, InputError, escape_unprintable
from getagrip.io import files, plugins
from getagrip.io.source_checksum import locate_error
from getagrip.io.storage import ARCHIVE_SUFFIX, Place, RemotePath
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import Finding, Probability
from getagrip.result.result import describe_grasp_probabilities

if TYPE_CHECKING:
    from getagrip.batch.engine import NamedTask
    from getagrip.fitting.options import Options

IMAGE_FILES, UNREAD_CLIP_FILES = "frames", ("truth.npz",)
"""Files of a clip that some reconstructions read (``fitting.evidence.texture``), and that none does."""
RESULT_RECORD_FILE, RESULT_POSES_FILE = "result.json", "result.npz"
"""Files of a result; the first marks a folder as one."""

Progress = Callable[[str, float], None]
"""Called with the name of the stage and its completed fraction, 0 to 1."""


@dataclass(frozen=True)
class Job:
    """A clip to reconstruct."""

    name: str
    clip: Path
    out: Path
    """The result's own folder."""
    options: Options
    overwrite: bool
    origin: str = ""
    """Address of the original, for a clip that is a copy."""
    threads: int = 1
    """Number of threads that share the hypotheses."""


@dataclass(frozen=True)
class StreamedJob:
    """A clip to reconstruct in an object store, or with its result in one."""

    name: str
    clip: Place
    out: Place
    """The result's own folder."""
    options: Options
    overwrite: bool
    threads: int = 1
    """Number of threads that share the hypotheses."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a clip (or of a path without one)."""

    name: str
    """Empty where a path is neither a clip nor a folder."""
    state: Literal["done", "kept", "failed"]
    """``kept``: a valid result existed already."""
    message: str
    trace: str = ""
    """Traceback of the error, for ``--debug``."""
    findings: tuple[Finding, ...] = ()
    probability_right: Probability | None = None
    """Probability that the poses are right in the hand; None without a calibrated one."""
    probability_right_in_camera: Probability | None = None
    """Probability that the poses are right in the camera; None without a calibrated one."""
    probability_looks_right: Probability | None = None
    """Probability that a draft is right but for distance and size; None of other results."""
    inputs: str = ""
    """Checksum of the clip; empty where the clip could not be read."""
    status: str = ""
    """Status of a result."""
    iou: float | None = None
    """Mean IOU over frames."""
    ambiguous: bool | None = None
    """True if a result is ambiguous; None without a result."""
    seconds: float = 0.0
    """Run time of the reconstruction [s]."""
    path: str = ""
    """Absolute path of an argument without a clip."""


def lost_outcome(job: NamedTask, why: str) -> Outcome:
    """Make the outcome of a job whose process died or was killed."""
    return Outcome(job.name, "failed", why)


def failed_outcome(name: str, error: Exception) -> Outcome:
    """Make the outcome of a clip that raised an error; an unexpected error names its line in the user's own code."""
    expected = isinstance(error, GetagripError | OSError)
    message = str(error)
    if not expected:
        where = locate_error(error)
        message = f"{f'{where}:' if where else 'unexpected'} {type(error).__name__}: {error}"
    if isinstance(error, MemoryError):
        message = f"it needs more memory than is available, or than --limit-gb allows;  {error}".removesuffix("; ")
    trace = "".join(traceback.format_exception(error))
    return Outcome(name, "failed", escape_unprintable(" ".join(message.split())), trace)


def preload_solver() -> None:
    """Load and compile the solver before the time of a reconstruction counts."""
    from getagrip.compiling import COMPILATION_MESSAGE, compile_once
    from getagrip.io.terminal import print_note

    compile_once(lambda: print_note(COMPILATION_MESSAGE))
    import getagrip.reconstruct  # noqa: F401


def reconstruct_one(job: Job, progress: Progress | None = None) -> Outcome:
    """Reconstruct a clip and write its result, unless a valid one exists. Raises nothing.

    A valid result is readable and of the same clip, options and code. Any other result is replaced, and the outcome
    gives the reason.
    """
    try:
        checksum = input_sha256(job.clip)
        existing, why = existing_outcome(job, checksum)
        if existing is not None:
            return existing
        result, views = _reconstruct_unchanged_clip(job, checksum, progress)
        meanwhile, _ = existing_outcome(job, checksum)
        if meanwhile is not None and not job.overwrite:
            return meanwhile
        metrics = {"iou_full": result.mean_iou, **views}
        made_by = software_of_method(job.options.method)
        write_result(result, job.out, checksum, metrics, job.origin or job.clip, overwrite=True, made_by=made_by)
    except Exception as error:  # an error in one clip must not end the others
        return failed_outcome(job.name, error)
    from getagrip.fitting.stages.confidence import uncalibrated_reason

    known = ", ".join(f"{right} {where}" for where, right in result.probabilities.items())
    probability = f"right with a probability of {known}" if known else ""
    if grasps := describe_grasp_probabilities(result.segments):
        probability = grasps
    if not known and (reason := uncalibrated_reason(job.options, result.findings, result.energy)):
        probability = f"{probability or 'no probability that it is right'} ({reason})"
    about = (
        f"IOU {result.mean_iou:.2f}{_worst_view(views)}",
        probability,
        result.looks,
        "ambiguous" * result.ambiguous,
    )
    summary = ", ".join(filter(None, (*about, f"{result.seconds['total']:.1f} s", str(job.out))))
    again = f"done again, since {why}: " if why else ""
    return _result_outcome(job, "done", f"{again}{summary}; {result.message}", result, checksum)


def _worst_view(views: Mapping[str, float]) -> str:
    """Name the further view in which the IOU is lowest; empty without any."""
    known = [(value, key.partition(":")[2]) for key, value in views.items() if not math.isnan(value)]
    if not known:
        return ""
    value, name = min(known)
    return f" ({value:.2f} in {name}{f', the worst of {len(known)} further views' if len(known) > 1 else ''})"


def _reconstruct_unchanged_clip(
    job: Job, checksum: str, progress: Progress | None
) -> tuple[Reconstruction, dict[str, float]]:
    """Return the result of the clip, and its IOU in further views by the metrics' keys.

    Raises ``InputError`` where the clip no longer has the checksum after it was read.
    """
    from getagrip.metrics.evaluate.metric import nan_mean
    from getagrip.metrics.evaluate.results import iou_of_views
    from getagrip.reconstruct import reconstruct

    clip = read_clip(job.clip)
    with plugins.convert_base_exceptions():
        result = reconstruct(clip, None, job.options, progress, job.threads)
    views = {key: nan_mean(values) for key, values in iou_of_views(result, clip).items()}
    if input_sha256(job.clip) != checksum:
        raise InputError(job.clip, "", "files that changed while they were read", "a clip that stays as it is")
    return result, views


def existing_outcome(job: Job, checksum: str) -> tuple[Outcome | None, str]:
    """Return the outcome of a job with a valid result, else None and the reason (empty without a result).

    ``checksum`` is the clip's. Raises ``UsageError`` where the result's folder holds something else.
    """
    method, options = job.options.method, asdict(job.options)
    valid, why = valid_result(job.out, checksum, method, options, software_of_method(method), job.overwrite)
    if valid is None:
        return None, why
    message = f"already done in {job.out}, IOU {valid[0].mean_iou:.2f}"
    return _result_outcome(job, "kept", message, valid[0], checksum), ""


def _result_outcome(
    job: Job, state: Literal["done", "kept"], message: str, result: Reconstruction, checksum: str
) -> Outcome:
    return Outcome(
        job.name, state, message, findings=result.findings, probability_right=result.probability_right,
        probability_right_in_camera=result.probability_right_in_camera,
        probability_looks_right=result.probability_looks_right,
        inputs=checksum, status=result.message, iou=result.mean_iou, ambiguous=result.ambiguous,
        seconds=float(result.seconds.get("total", 0.0)),
    )  # fmt: skip


def reconstruct_streamed(job: StreamedJob, progress: Progress | None = None) -> Outcome:
    """Reconstruct a clip as ``reconstruct_one`` does, by local copies of files in the store. Raises nothing."""
    try:
        with files.temporary_folder(_temporary_folder()) as folder:
            outcome = _reconstruct_local_copy(job, folder, progress)
            message = outcome.message
            for copy, original in (("clip", job.clip), ("result", job.out)):
                message = message.replace(str(folder / copy / job.name), str(original))
            return replace(outcome, message=message)
    except Exception as error:  # a full disk
        return failed_outcome(job.name, error)


@cache
def _temporary_folder() -> Path:
    """Return the folder of temporary files, after removing those of killed processes."""
    folder = Path(tempfile.gettempdir())
    files.remove_stale_folders(folder)
    return folder


def _reconstruct_local_copy(job: StreamedJob, folder: Path, progress: Progress | None) -> Outcome:
    """Return the outcome; its message names files in the temporary folder."""
    try:
        clip, out = _fetch_clip(job, folder), _fetch_result(job, folder)
        replaces = out.exists()
        local = Job(job.name, clip, out, job.options, job.overwrite, str(job.clip), job.threads)
        outcome = reconstruct_one(local, progress)
        if outcome.state == "done" and isinstance(job.out, RemotePath):
            _upload_result(out, job.out, replaces)
        return outcome
    except Exception as error:  # an error in one clip must not end the others
        return failed_outcome(job.name, error)


def _fetch_clip(job: StreamedJob, folder: Path) -> Path:
    """Copy the clip to this machine. Raises ``InputError`` where its name differs from its folder's in the store."""
    if isinstance(job.clip, Path):
        return job.clip
    clip = folder / "clip" / job.name
    clip.mkdir(parents=True)
    copy = job.clip.unpack_to if job.clip.name.endswith(ARCHIVE_SUFFIX) else job.clip.copy_to
    copy(clip, (IMAGE_FILES, *UNREAD_CLIP_FILES))
    from getagrip.fitting.evidence.texture import reads_images

    if reads_images(clip):
        copy(clip, UNREAD_CLIP_FILES)
    name = read_name(clip)
    if name != job.name:
        expected = f"{job.name}, as its folder or archive is named"
        raise InputError(clip / "clip.json", "name", f"the name {files.shorten_value(name)}", expected)
    return clip


def _fetch_result(job: StreamedJob, folder: Path) -> Path:
    """Return the result's folder on this machine, with copies of an earlier result's files."""
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
    """Copy a result into the store; its folder there is no result until the last step."""
    if replaces:
        (out / RESULT_RECORD_FILE).remove()
    for name in (RESULT_POSES_FILE, RESULT_RECORD_FILE):
        (out / name).write((result / name).read_bytes())


@contextmanager
def local_results(out: Place, names: Sequence[str]) -> Iterator[Path]:
    """Copy the named results to a temporary folder on this machine; a local ``out`` is used as it is."""
    if isinstance(out, Path):
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="getagrip.") as folder:
        for name in (RESULT_RECORD_FILE, RESULT_POSES_FILE):
            out.fetch([f"{result}/{name}" for result in names], files.MAX_JSON_BYTES, Path(folder))
        yield Path(folder)
