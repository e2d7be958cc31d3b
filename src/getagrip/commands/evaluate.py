"""``getagrip evaluate``: results against their clips."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from getagrip.batch.clips import print_outcome
from getagrip.batch.entries import FILE as LEDGER
from getagrip.batch.job import Outcome, failure
from getagrip.batch.pool import DIED, cores, in_processes
from getagrip.batch.share import FEW
from getagrip.batch.summary import PAGE, TABLE
from getagrip.commands.evaluate_meshes import Meshes, MeshJob, evaluate_clip_meshes, mesh_jobs
from getagrip.commands.evaluate_poses import OtherPoses, PoseJob, evaluate_clip_poses, pose_jobs
from getagrip.errors import InputError, UsageError
from getagrip.evaluation import contact_tables, evaluate_result, results_table, summary
from getagrip.evaluation.results import Evaluation
from getagrip.io import files
from getagrip.io.terminal import console, progress_bar, report

BATCH_FILES = (LEDGER, TABLE, PAGE)

Evaluated = tuple[Evaluation | None, list[Outcome]]
"""All metrics, and what could not be read."""


@dataclass(frozen=True)
class ResultJob:
    """A result to evaluate."""

    folder: Path
    clips: Path | None


def evaluate_results(
    paths: Sequence[Path],
    clips: Path | None,
    meshes: Meshes | None,
    poses: OtherPoses | None,
    contact: bool,
    json: Path | None,
    debug: bool,
) -> int:
    """Print the metrics of results, and write them to a file; 1 if anything could not be evaluated, else 0.

    A path is a result, or a folder of results. ``meshes`` and ``poses`` of another system are evaluated in the frames
    of our results of the same clip, else in all of the clip's. ``contact`` adds a table of stable contact.
    Raises ``UsageError`` where there is nothing to do, and ``InputError`` where there are no such meshes or poses.
    """
    if not paths and meshes is None and poses is None:
        raise UsageError("RESULT: name at least one result, or --poses, or --meshes")
    jobs: list[ResultJob] = []
    problems: list[Outcome] = []
    for path in paths:
        try:
            jobs += [ResultJob(folder, clips) for folder in results_in(path)]
        except (InputError, OSError) as error:
            problems.append(failure("", error))
    evaluations: list[Evaluation] = []
    with progress_bar() as bar:
        task = bar.add_task("results", total=len(jobs), visible=bool(jobs))
        for made, failed in _in_order(evaluate_one, jobs, lambda: bar.advance(task)):
            evaluations += [] if made is None else [made]
            problems += failed
        frames = {made.clip: tuple(made.frames) for made in evaluations}
        others: list[MeshJob | PoseJob] = [] if meshes is None else [*mesh_jobs(meshes, frames)]
        others += [] if poses is None else pose_jobs(poses, frames)
        of_others = bar.add_task("of other systems", total=len(others), visible=bool(others))
        for made, failed in _in_order(evaluate_other, others, lambda: bar.advance(of_others)):
            evaluations += [] if made is None else [made]
            problems += failed
    for outcome in problems:
        print_outcome(outcome, debug)
    if evaluations:
        for table in (results_table(evaluations), *(contact_tables(evaluations) if contact else ())):
            console().print(table)
    for made in evaluations:
        _print_doubts(made)
    if json is not None:
        files.write_json(json, summary(evaluations))
    return 1 if problems else 0


def _print_doubts(made: Evaluation) -> None:
    """What speaks against an evaluated result, and what is to be known about its metrics, on stderr."""
    doubts = [*made.findings, *made.notes]
    if missing := int(made.metrics.get("frames_without_mesh", 0)):
        doubts.append(f"no mesh of {missing} of {len(made.frames)} frames: IOU 0, no contact")
    for doubt in doubts:
        report(f"{made.method}, {made.clip}: {doubt}")


J = TypeVar("J", ResultJob, MeshJob | PoseJob)


def _in_order(work: Callable[[J], Evaluated], jobs: Sequence[J], advance: Callable[[], None]) -> list[Evaluated]:
    """What each job gives; many jobs are shared out over processes."""
    done: dict[int, Evaluated] = {}
    places = {id(job): place for place, job in enumerate(jobs)}
    for job, made in _done(work, jobs):
        dead = None, [Outcome(str(job.folder), "failed", DIED)]
        done[places[id(job)]] = made or dead
        advance()
    return [done[place] for place in sorted(done)]


def _done(work: Callable[[J], Evaluated], jobs: Sequence[J]) -> Iterator[tuple[J, Evaluated | None]]:
    if len(jobs) <= FEW or cores() == 1:
        return ((job, work(job)) for job in jobs)
    return in_processes(work, jobs, min(len(jobs), cores()))


def evaluate_other(job: MeshJob | PoseJob) -> Evaluated:
    """The metrics of another system's meshes or poses, or why there are none. Raises nothing."""
    return evaluate_clip_meshes(job) if isinstance(job, MeshJob) else evaluate_clip_poses(job)


def evaluate_one(job: ResultJob) -> Evaluated:
    """The metrics of a result, or why there are none. Raises nothing."""
    try:
        return evaluate_result(job.folder, job.clips), []
    except Exception as error:  # one result's trouble must not end the others
        return None, [failure("" if isinstance(error, InputError) else str(job.folder), error)]


def of_batch(path: Path) -> bool:
    """Whether a path is one of the files that a batch writes beside its results: ``results/*`` names them, too."""
    return path.name in BATCH_FILES and path.is_file()


def results_in(path: Path) -> list[Path]:
    """The result folders that a path stands for, none for a batch's file. Raises ``InputError`` where it holds none."""
    if of_batch(path):
        return []
    if (path / "result.json").exists():
        return [path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    results = sorted(found.parent for found in path.glob("*/result.json"))
    if not results:
        raise no_result(path)
    return results


def no_result(path: Path) -> InputError:
    """The error for a folder in which there is no result."""
    given = "a clip" if (path / "clip.json").exists() else "no result.json in it or in its folders"
    return InputError(path, "", given, "a result that getagrip reconstruct made, or a folder of results")
