"""One clip from its folder to its result folder; whatever goes wrong becomes a sentence.

Limits of the time and memory of one job: a clip that needs more fails, and is named.

One clip in an object store: copied to this machine, reconstructed, and its result copied back.

A result is written with its ``result.json`` last, and without that it is none: half of one is never taken for done.
"""

from __future__ import annotations

import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.batch.freshness import software_of_method, valid_result
from getagrip.clip import input_sha256, read_clip, read_name
from getagrip.errors import GetagripError, InputError, UsageError, escape_unprintable
from getagrip.io import files, plugins
from getagrip.io.source_checksum import locate_error
from getagrip.io.storage import ARCHIVE_SUFFIX, Place, RemotePath
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import Finding, Probability
from getagrip.result.result import describe_grasp_probabilities

if TYPE_CHECKING:
    from getagrip.fitting.options import Options

MAX_JOB_LIMIT = 1e6
"""Most seconds and GB: the kernel and the clock count no farther than some thousand times as many."""


@dataclass(frozen=True)
class Limits:
    """The limits of each job.

    Raises ``UsageError`` for limits that are no positive numbers, or that cannot be held here.
    """

    seconds: Annotated[float | None, arg(name="limit-seconds", metavar="S", help_behavior_hint="(default: none)")] = (
        None
    )
    """Time limit of a clip (in bench, with all its methods) or of a part of a dataset [s]."""
    gigabytes: Annotated[float | None, arg(name="limit-gb", metavar="GB", help_behavior_hint="(default: none)")] = None
    """Memory limit of each process [10^9 bytes] (Linux only)."""

    def __post_init__(self) -> None:
        for option, value in (("--limit-seconds", self.seconds), ("--limit-gb", self.gigabytes)):
            if value is not None and not (0.0 < value <= MAX_JOB_LIMIT):
                raise UsageError(f"{option} must be above 0 and at most {MAX_JOB_LIMIT:g} (got {value:g})")
        if self.gigabytes is not None and sys.platform != "linux":
            raise UsageError(
                f"--limit-gb cannot be used with {sys.platform}: only Linux limits the memory of a process"
            )

    def __bool__(self) -> bool:
        return self.seconds is not None or self.gigabytes is not None

    @property
    def too_long(self) -> str:
        """Why a job was ended, in words."""
        return f"it took longer than {self.seconds:g} s (--limit-seconds)"

    @property
    def suspicion(self) -> str:
        """Why a process may have died."""
        return "out of memory?" if self.gigabytes is None else f"out of memory, {self.gigabytes:g} GB (--limit-gb)?"

    def enforce(self) -> None:
        """Limit the memory of this process, which is to do such jobs and nothing else."""
        if self.gigabytes is not None:
            import resource

            most = resource.getrlimit(resource.RLIMIT_DATA)[1]
            wanted = int(self.gigabytes * 1e9)
            resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))


NO_LIMITS = Limits()
"""Any time, any memory."""

Progress = Callable[[str, float], None]
"""Called with the stage in words, and how much of it is done, 0 to 1."""


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
    """That share the hypotheses."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a clip (or of a path without one)."""

    name: str
    """Empty where a path is no clip and no folder."""
    state: Literal["done", "kept", "failed"]
    """``kept``: the result stood there already."""
    message: str
    trace: str = ""
    """Place where the error arose, for ``--debug``."""
    findings: tuple[Finding, ...] = ()
    """Findings of a result."""
    probability_right: Probability | None = None
    probability_right_in_camera: Probability | None = None
    """Probability in the camera; None where it is not known."""
    inputs: str = ""
    """Checksum of the clip, where it could be read."""
    status: str = ""
    """Status of a result."""
    iou: float | None = None
    """Mean IOU of a result over its frames."""
    ambiguous: bool | None = None
    """True if a result is ambiguous; None without a result."""
    seconds: float = 0.0
    """Time that a result took [s]."""
    path: str = ""
    """Whole path of what gave no clip to work on."""


def failed_outcome(name: str, error: Exception) -> Outcome:
    """Make the outcome of a clip that raised an error; unexpected ones name the place in the user's own code."""
    expected = isinstance(error, GetagripError | OSError)
    message = str(error)
    if not expected:
        where = locate_error(error)
        message = f"{f'{where}:' if where else 'unexpected'} {type(error).__name__}: {error}"
    if isinstance(error, MemoryError):
        message = f"it needs more memory than is available, or than --limit-gb allows;  {error}".removesuffix("; ")
    return Outcome(
        name, "failed", escape_unprintable(" ".join(message.split())), "".join(traceback.format_exception(error))
    )


def preload_solver() -> None:
    """Load what every reconstruction needs, and have it compiled, before its time counts."""
    from getagrip.compiling import COMPILATION_MESSAGE, compile_once
    from getagrip.io.terminal import print_note

    compile_once(lambda: print_note(COMPILATION_MESSAGE))
    import getagrip.reconstruct  # noqa: F401


def reconstruct_one(job: Job, progress: Progress | None = None) -> Outcome:
    """Reconstruct a clip and write its result, unless a good one is there already. Raises nothing.

    A good one was made from the same clip, with the same options, by the same code, and can be read. Another result is
    replaced, and the outcome says why.
    """
    try:
        checksum = input_sha256(job.clip)
        there, why = existing_outcome(job, checksum)
        if there is not None:
            return there
        result, checksum = _reconstruct_unchanged_clip(job, progress)
        meanwhile, _ = existing_outcome(job, checksum)
        if meanwhile is not None and not job.overwrite:
            return meanwhile
        metrics = {"iou_full": result.mean_iou}
        origin = job.origin or job.clip
        write_result(
            result, job.out, checksum, metrics, origin, overwrite=True, made_by=software_of_method(job.options.method)
        )
    except Exception as error:  # one clip's trouble must not end the others
        return failed_outcome(job.name, error)
    from getagrip.fitting.stages.confidence import uncalibrated_reason

    known = ", ".join(f"{right} {where}" for where, right in result.probabilities.items())
    probably = f"right with a probability of {known}" if known else ""
    if grasps := describe_grasp_probabilities(result.segments):
        probably = grasps
    if not known and (none := uncalibrated_reason(job.options, result.findings, result.energy)):
        probably = f"{probably or 'no probability that it is right'} ({none})"
    about = (f"IOU {result.mean_iou:.2f}", probably, result.looks, "ambiguous" * result.ambiguous)
    said = ", ".join(filter(None, (*about, f"{result.seconds['total']:.1f} s", str(job.out))))
    again = f"done again, since {why}: " if why else ""
    summary = f"{again}{said}; {result.message}"
    return _result_outcome(job, "done", summary, result, checksum)


def _reconstruct_unchanged_clip(job: Job, progress: Progress | None) -> tuple[Reconstruction, str]:
    """Reconstruct the clip, and return the checksum of its inputs.

    Raises ``InputError`` where the clip has changed meanwhile: some of it was read before, some after.
    """
    from getagrip.reconstruct import reconstruct

    before = input_sha256(job.clip)
    with plugins.convert_base_exceptions():
        result = reconstruct(read_clip(job.clip), None, job.options, progress, job.threads)
    if input_sha256(job.clip) != before:
        raise InputError(job.clip, "", "files that changed while they were read", "a clip that stays as it is")
    return result, before


def existing_outcome(job: Job, checksum: str) -> tuple[Outcome | None, str]:
    """Return the outcome of a job whose result is there and valid, else None and the reason.

    ``checksum`` is that of the clip. Raises ``UsageError`` where something else is in the result's place.
    """
    options = asdict(job.options)
    there, why = valid_result(
        job.out, checksum, job.options.method, options, software_of_method(job.options.method), job.overwrite
    )
    if there is None:
        return None, why
    return _result_outcome(
        job, "kept", f"already done in {job.out}, IOU {there[0].mean_iou:.2f}", there[0], checksum
    ), ""


def _result_outcome(
    job: Job, state: Literal["done", "kept"], message: str, result: Reconstruction, checksum: str
) -> Outcome:
    return Outcome(
        job.name, state, message, findings=result.findings, probability_right=result.probability_right,
        probability_right_in_camera=result.probability_right_in_camera,
        inputs=checksum, status=result.message, iou=result.mean_iou, ambiguous=result.ambiguous,
        seconds=float(result.seconds.get("total", 0.0)),
    )  # fmt: skip


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
        with files.temporary_folder(_temporary_folder()) as folder:
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
    files.remove_stale_folders(folder)
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
