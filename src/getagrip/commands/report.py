"""``getagrip report``: pages of results, and an index of a folder of them."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from itertools import filterfalse
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from tyro.conf import Positional, arg

from getagrip.batch.keep import KeepOptions
from getagrip.commands.command import ClipsFolder, Command, Workers
from getagrip.commands.evaluate import is_batch_file, missing_result_error
from getagrip.errors import InputError, UsageError
from getagrip.io.arguments import Flag
from getagrip.io.terminal import print_result, progress_bar

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.pages import IndexRow

REPORT_PAGE, REPORT_PICTURE, REPORT_VIDEO, INDEX_PAGE = "report.html", "report.png", "report.mp4", "index.html"
MAX_RESULTS_DEPTH = 4
"""Folders below the one that is named in which results are looked for; a benchmark's are three below."""
Reported: TypeAlias = "tuple[IndexRow, Outcome | None]"


@dataclass(frozen=True)
class ReportRequest:
    """A request to write pages and pictures of results."""

    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    mp4: Flag = False
    """Also write report.mp4, a film of the result over its images and from the side."""
    index_only: Flag = False
    """Write only the index of a folder of results, with links to pages that are there already."""
    keep: Annotated[KeepOptions, arg(name="")] = field(default_factory=KeepOptions)


@dataclass(frozen=True, kw_only=True)
class Report(Command):
    """Write a page of each result that plays in 3D without a network, report.html; for a folder also index.html."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="PATH...", help_behavior_hint="")] = ()
    """Result folders, which get report.png as well, or folders that hold results."""
    request: Annotated[ReportRequest, arg(name="")] = field(default_factory=ReportRequest)
    workers: Workers = None
    """Number of processes."""

    def check(self) -> None:
        super().check()
        if not self.paths:
            raise UsageError("missing PATH: name at least one result, or a folder of results")
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers must be 1 or more (got {self.workers})")

    def run(self) -> int:
        """Write what is wanted of each path; 1 if anything failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome

        failed = False
        for path in filterfalse(is_batch_file, self.paths):
            try:
                if (path / "result.json").exists():
                    _, problem = report_one(ReportJob(path, None, self.request))
                    problems = [problem] if problem is not None else []
                    written = [] if problems else [REPORT_PAGE, REPORT_PICTURE, *[REPORT_VIDEO] * self.request.mp4]
                else:
                    problems = _report_folder(path, self.request, self.workers)
                    written = [INDEX_PAGE]
            except (InputError, OSError) as error:
                problems, written = [failed_outcome("", error)], []
            for name in written:
                print_result(str(path / name))
            for problem in problems:
                print_outcome(problem, self.debug)
            failed |= bool(problems)
        return int(failed)


@dataclass(frozen=True)
class ReportJob:
    """A result to report on; ``root`` is the folder of the index, None for a result that was named itself."""

    folder: Path
    root: Path | None
    request: ReportRequest

    @property
    def name(self) -> str:
        """Path below the index."""
        return "" if self.root is None else self.folder.relative_to(self.root).as_posix()


def find_result_folders(path: Path, may_lack: bool = False) -> list[Path]:
    """List the result folders anywhere in a folder, sorted.

    Raises ``InputError`` where there is none but may not be.
    """
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    found = []
    for place, folders, names in os.walk(path):
        here = Path(place)
        if "result.json" in names:
            found.append(here)
        if "result.json" in names or len(here.relative_to(path).parts) >= MAX_RESULTS_DEPTH:
            folders.clear()
        folders[:] = [name for name in folders if not name.startswith(".")]
    if not found and not may_lack:
        raise missing_result_error(path)
    return sorted(found)


def report_one(job: ReportJob) -> Reported:
    """Write the pages of a result; its row of the index, and what went wrong. Raises nothing."""
    from getagrip.batch.job import failed_outcome

    try:
        return _write_result_pages(job), None
    except Exception as error:  # one result's trouble must not end the others
        outcome = failed_outcome("" if isinstance(error, InputError) else str(job.folder), error)
        return _failed_result_row(job, outcome.message), outcome


def _write_result_pages(job: ReportJob) -> IndexRow:
    """Write the pages of a result."""
    from getagrip.evaluation import evaluate, read_result_clip_masks
    from getagrip.film import write_film
    from getagrip.pages import index_row, write_page
    from getagrip.pictures.report import write_report
    from getagrip.pictures.shown import View
    from getagrip.result import read_result_record

    folder, request = job.folder, job.request
    result, clip, masks = read_result_clip_masks(folder, request.clips)
    evaluation, view = evaluate(result, clip, masks), View.of(result, clip, masks)
    if job.root is None or not request.index_only:
        write_page(view, evaluation, read_result_record(folder), folder / REPORT_PAGE)
    if job.root is None:
        write_report(result, clip, masks, folder / REPORT_PICTURE, evaluation.metrics)
    if request.mp4:
        write_film(view, folder / REPORT_VIDEO)
    return request.keep.marked(index_row(job.name, view, evaluation, (folder / REPORT_PAGE).is_file()), result)


def _failed_result_row(job: ReportJob, problem: str) -> IndexRow:
    """Make the row of a result whose pages could not be written, from its own files, if they can be read."""
    from getagrip.pages import IndexRow, index_row_without_clip
    from getagrip.result import read_result

    try:
        result, record = read_result(job.folder)
        return job.request.keep.marked(index_row_without_clip(job.name, result, record["metrics"], problem), result)
    except Exception:  # its files may hold anything
        return IndexRow(job.name, problem=problem, flags=("failed",))


def _report_folder(path: Path, request: ReportRequest, workers: int | None) -> list[Outcome]:
    """Report on all results in a folder and write their index, with what its ledger knows; what went wrong."""
    from getagrip.batch.entries import open_existing_ledger
    from getagrip.batch.executor import PROCESS_DIED_TWICE, for_each_job
    from getagrip.batch.job import Outcome
    from getagrip.batch.summary import SUMMARY_FILE, known_entries, row_without_result, write_summary_table
    from getagrip.pages import IndexRow, write_index

    with open_existing_ledger(path) as ledger:
        without = [] if ledger is None else [one for one in known_entries(ledger, path) if one.state != "done"]
        if ledger is not None:
            write_summary_table(ledger, path, path / SUMMARY_FILE, request.keep)
    jobs = [ReportJob(folder, path, request) for folder in find_result_folders(path, may_lack=bool(without))]

    def died(job: ReportJob) -> Reported:
        return IndexRow(job.name, problem=PROCESS_DIED_TWICE, flags=("failed",)), Outcome(
            str(job.folder), "failed", PROCESS_DIED_TWICE
        )

    with progress_bar(counted=True) as bar:
        task = bar.add_task("results", total=len(jobs))
        ends = for_each_job(report_one, jobs, died, lambda _: bar.advance(task), workers)
    rows = [*(row for row, _ in ends), *map(row_without_result, without)]
    tables = sorted(file.name for file in (*path.glob("*.md"), *path.glob(SUMMARY_FILE)))
    write_index(rows, path.resolve().name, tables, path / INDEX_PAGE)
    return [problem for _, problem in ends if problem is not None]
