"""One clip from its folder to its result folder; whatever goes wrong becomes a sentence."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from getagrip.batch.claims import claim
from getagrip.clip import input_sha256, read_clip, read_name
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.finding import Finding, read_findings
from getagrip.io import files
from getagrip.probability import Probability, read_probability
from getagrip.result import is_result, read_record, write_result

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


@dataclass(frozen=True)
class Outcome:
    """What became of a clip (or of a path where none was found)."""

    name: str
    """Empty where a path is no clip."""
    state: Literal["done", "kept", "failed", "elsewhere"]
    """``kept``: the result stood there already; ``elsewhere``: another run is at work on it."""
    message: str
    trace: str = ""
    """Where the error arose, for ``--debug``."""
    findings: tuple[Finding, ...] = ()
    """What is unusual about a result."""
    probability_right: Probability | None = None
    """Of a result, where it is known."""


def failure(name: str, error: Exception) -> Outcome:
    """The outcome of a clip that raised an error."""
    expected = isinstance(error, GetagripError | OSError)
    message = str(error) if expected else f"unexpected {type(error).__name__}: {error}"
    return Outcome(name, "failed", " ".join(message.split()), "".join(traceback.format_exception(error)))


def plan(paths: Sequence[Path], out: Path, options: Options, overwrite: bool) -> tuple[list[Job], list[Outcome]]:
    """A job for each clip, and the outcome of those that cannot have one. Raises ``UsageError`` as ``by_name`` does."""
    clips, failed = by_name(paths)
    return [Job(name, clip, out / name, options, overwrite) for name, clip in clips.items()], failed


def by_name(paths: Sequence[Path]) -> tuple[dict[str, Path], list[Outcome]]:
    """The folder of each clip by its name, and the outcome of those that have none.

    A path is a clip, or a folder of clips. Raises ``UsageError`` where two clips have the same name: what is made of
    them would have the same name too.
    """
    found: dict[str, Path] = {}
    failed: list[Outcome] = []
    for path in paths:
        try:
            clips = clips_in(path)
        except (InputError, OSError) as error:
            failed.append(failure("", error))
            continue
        for clip in clips:
            try:
                name = read_name(clip)
            except InputError as error:
                failed.append(failure(clip.name, error))
                continue
            if name in found:
                raise UsageError(f"{clip} and {found[name]} are both named {name!r}; give one at a time")
            found[name] = clip
    return found, failed


def clips_in(path: Path) -> list[Path]:
    """The clip folders that a path stands for. Raises ``InputError`` where it holds none."""
    if path.name == "clip.json" or (path / "clip.json").exists():
        return [path.parent if path.name == "clip.json" else path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a clip, or a folder of clips")
    clips = sorted(found.parent for found in path.glob("*/clip.json"))
    if not clips:
        raise InputError(path, "", "no clip.json in it or in its folders", "a clip, or a folder of clips")
    return clips


def reconstruct_one(job: Job, progress: Progress | None = None, wait: bool = True) -> Outcome:
    """Reconstruct a clip and write its result, unless that is settled already. Raises nothing.

    Where another run is at work on it, it is waited for, or else left to that.
    """
    try:
        with claim(job.out, wait) as free:
            return _reconstructed(job, progress) if free else Outcome(job.name, "elsewhere", "another run does it")
    except OSError as error:
        return failure(job.name, error)


def _reconstructed(job: Job, progress: Progress | None) -> Outcome:
    before = settled(job)
    if before is not None:
        return before
    try:
        from getagrip.fitting.reconstruct import reconstruct

        clip = read_clip(job.clip)
        checksum = input_sha256(job.clip)
        result = reconstruct(clip, None, job.options, progress)
        metrics = {"iou_full": result.mean_iou}
        write_result(result, job.out, checksum, metrics, clip_folder=job.clip, overwrite=job.overwrite)
    except Exception as error:  # one clip's trouble must not end the others
        meanwhile = settled(job)
        return meanwhile if meanwhile is not None and meanwhile.state == "kept" else failure(job.name, error)
    right = result.probability_right
    probably = "" if right is None else f", right with a probability of {right}"
    about = f"{probably}{', ambiguous' if result.ambiguous else ''}"
    summary = f"IOU {metrics['iou_full']:.2f}{about}, {result.seconds['total']:.1f} s, {job.out}; {result.status}"
    return Outcome(job.name, "done", summary, findings=result.findings, probability_right=right)


def settled(job: Job) -> Outcome | None:
    """The outcome of a job whose result is there already, or in whose place something else is; else None."""
    try:
        if not job.out.exists():
            return None
        if not is_result(job.out):
            raise UsageError(f"{job.out}: exists and is no result; it is not overwritten")
        if job.overwrite:
            return None
        record = read_record(job.out)
        other = _differences(job, record)
        if other:
            raise UsageError(f"{job.out}: holds a result of another {' and '.join(other)}; replace it with --overwrite")
        findings = read_findings(job.out / "result.json", record["findings"])
        right = read_probability(job.out / "result.json", record["probability_right"])
    except Exception as error:  # as above
        return failure(job.name, error)
    return Outcome(job.name, "kept", f"already done in {job.out}", findings=findings, probability_right=right)


def _differences(job: Job, record: dict[str, Any]) -> list[str]:
    """In what the result that is there differs from the one that the job would make."""
    options = json.loads(files.to_json(asdict(job.options)))
    wanted = {"method": job.options.method, "seed": job.options.seed, "options": options}
    if record["input_sha256"] != input_sha256(job.clip):
        return ["clip"]
    return [key for key, value in wanted.items() if record[key] != value][:1]
