"""``getagrip evaluate``: results against their clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from tyro.conf import arg

from getagrip.commands.command import ClipsFolder, Command, FirstNumber, Results
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.arguments import Flag, OptionalFile, OptionalFolder, one_of
from getagrip.io.terminal import console, print_note, progress_bar

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.commands.evaluate_others import OtherJob
    from getagrip.evaluation.results import Evaluation

Evaluated: TypeAlias = "tuple[Evaluation | None, list[Outcome]]"
"""All metrics, and what could not be read."""


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Print the metrics of results, and of another system's poses or meshes beside them."""

    results: Results = ()
    """Result folders, or folders of results."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    poses: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Another system's poses of the clip's mesh: one 4x4 for each frame (.npz, .npy, .json, .txt, or a file for each
    frame in a folder), or BOP's results (.csv). For many clips: a folder of such files or folders, named like the
    clips. They are of the clips that the results are of; without results it needs --clips. The rows appear under the
    name of PATH."""
    meshes: OptionalFolder = None
    """Another system's meshes, one for each frame, in metres: DIR/<clip>/<frame>.obj (.ply, .stl, .glb). Needs
    --mesh-frame, and without results --clips. The rows appear under the name of DIR."""
    mesh_frame: Annotated[Literal["camera", "hand"] | None, one_of("camera", "hand"), arg(help_behavior_hint="")] = None
    """The frame that the vertices of --meshes are in: the clip's camera frame, or its hand frame."""
    first: FirstNumber = None
    """The number that these files give to the clip's first frame, if they count from another start."""
    contact: Flag = False
    """Also print stable contact by nine definitions: within 0, 5 and 10 mm, each for the object's vertices, the hand's
    vertices, and points of the object's surface."""
    json: OptionalFile = None
    """Write every number here, unrounded."""

    def check(self) -> None:
        super().check()
        if not self.results and self.meshes is None and self.poses is None:
            raise UsageError("missing RESULT: name at least one result, or --poses, or --meshes")
        other = "--poses" if self.poses is not None else "--meshes"
        if (self.poses is not None or self.meshes is not None) and self.clips is None and not self.results:
            needed = "the clip, or the folder that holds the clips, or a result of the clip"
            raise UsageError(f"missing --clips: {other} needs {needed}")
        if self.meshes is not None and self.mesh_frame is None:
            raise UsageError("missing --mesh-frame: --meshes needs the frame of their vertices, camera or hand")
        if self.meshes is None and self.mesh_frame is not None:
            raise UsageError("missing --meshes: --mesh-frame is the frame of their vertices")

    def run(self) -> int:
        """Print the metrics of results, and write them to a file; 1 if anything could not be evaluated, else 0.

        Another system's meshes and poses are evaluated in the frames of our results of the same clip, else in all of
        the clip's. Raises ``InputError`` where there are no such meshes or poses.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.executor import for_each_job
        from getagrip.batch.job import failed_outcome
        from getagrip.commands.evaluate_others import evaluate_other, mesh_jobs, pose_jobs
        from getagrip.evaluation import contact_tables, results_table, summary

        jobs: list[ResultJob] = []
        problems: list[Outcome] = []
        for path in self.results:
            try:
                jobs += [ResultJob(folder, self.clips) for folder in list_result_folders(path)]
            except (InputError, OSError) as error:
                problems.append(failed_outcome("", error))
        evaluations: list[Evaluation] = []
        folders = self._folders_of_clips(jobs)
        with progress_bar() as bar:
            task = bar.add_task("results", total=len(jobs), visible=bool(jobs))
            for made, failed in for_each_job(evaluate_one, jobs, _failed_evaluation, lambda _: bar.advance(task)):
                evaluations += [] if made is None else [made]
                problems += failed
            frames = {made.clip: tuple(made.frames) for made in evaluations}
            others = [] if self.meshes is None else mesh_jobs(self, frames, folders)
            others += [] if self.poses is None else pose_jobs(self, frames, folders)
            of_others = bar.add_task("of other systems", total=len(others), visible=bool(others))
            for made, failed in for_each_job(
                evaluate_other, others, _failed_evaluation, lambda _: bar.advance(of_others)
            ):
                evaluations += [] if made is None else [made]
                problems += failed
        for outcome in problems:
            print_outcome(outcome, self.debug)
        if evaluations:
            for table in (results_table(evaluations), *(contact_tables(evaluations) if self.contact else ())):
                console().print(table)
        for made in evaluations:
            _print_warnings(made)
        if self.json is not None:
            files.write_json(self.json, summary(evaluations))
        return 1 if problems else 0

    def _folders_of_clips(self, jobs: list[ResultJob]) -> dict[str, Path]:
        """Find the folders of the results' clips, by name, where another system's output is of them."""
        from contextlib import suppress

        from getagrip.evaluation.results import clip_folder
        from getagrip.result import read_result_record

        folders: dict[str, Path] = {}
        for job in jobs if self.poses is not None or self.meshes is not None else []:
            with suppress(InputError, OSError):  # evaluating the result says what is wrong with it
                record = read_result_record(job.folder)
                folders[record["clip"]] = clip_folder(job.folder, record, job.clips)
        return folders


@dataclass(frozen=True)
class ResultJob:
    """A result to evaluate."""

    folder: Path
    clips: Path | None


def _print_warnings(made: Evaluation) -> None:
    """Print the findings of an evaluated result, and notes on its metrics, on stderr."""
    warnings = [*made.findings, *made.notes]
    if missing := int(made.metrics.get("frames_without_mesh", 0)):
        warnings.append(f"no mesh of {missing} of {len(made.frames)} frames: IOU 0, no contact")
    for warning in warnings:
        print_note(f"{made.method}, {made.clip}: {warning}")


def _failed_evaluation(job: ResultJob | OtherJob) -> Evaluated:
    from getagrip.batch.executor import PROCESS_DIED_TWICE
    from getagrip.batch.job import Outcome

    return None, [Outcome(str(job.folder), "failed", PROCESS_DIED_TWICE)]


def evaluate_one(job: ResultJob) -> Evaluated:
    """Evaluate a result; failures are returned, not raised."""
    from getagrip.batch.job import failed_outcome
    from getagrip.evaluation import evaluate_result

    try:
        return evaluate_result(job.folder, job.clips), []
    except Exception as error:  # one result's trouble must not end the others
        return None, [failed_outcome("" if isinstance(error, InputError) else str(job.folder), error)]


def is_batch_file(path: Path) -> bool:
    """Return whether a path is a file that a batch writes beside its results: ``results/*`` names them, too."""
    from getagrip.batch.entries import LEDGER_FILE as LEDGER
    from getagrip.batch.summary import INDEX_FILE, SUMMARY_FILE

    return path.name in (LEDGER, SUMMARY_FILE, INDEX_FILE) and path.is_file()


def list_result_folders(path: Path) -> list[Path]:
    """List the result folders that a path stands for, none for a batch's file.

    Raises ``InputError`` where it holds none.
    """
    if is_batch_file(path):
        return []
    if (path / "result.json").exists():
        return [path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    results = sorted(found.parent for found in path.glob("*/result.json"))
    if not results:
        raise missing_result_error(path)
    return results


def missing_result_error(path: Path) -> InputError:
    """Make the error for a folder in which there is no result."""
    got = "a clip" if (path / "clip.json").exists() else "no result.json in it or in its folders"
    return InputError(path, "", got, "a result that getagrip reconstruct made, or a folder of results")
