"""One clip from its folder to its result folder; whatever goes wrong becomes a sentence."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from getagrip.batch.validity import software_of_method, valid_result
from getagrip.clip import input_sha256, read_clip
from getagrip.errors import GetagripError, InputError, escape_unprintable
from getagrip.finding import Finding
from getagrip.io import plugins
from getagrip.io.own_code import locate_error
from getagrip.probability import Probability
from getagrip.result import Reconstruction, write_result
from getagrip.result.segments import describe_grasp_probabilities

if TYPE_CHECKING:
    from getagrip.fitting.options import Options

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
    import getagrip.timelines.reconstruct  # noqa: F401


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
    from getagrip.fitting.judge import uncalibrated_reason

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
    from getagrip.timelines.reconstruct import reconstruct

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
