"""``getagrip report``, ``view`` and ``status``: results as pages with an index, on a local page, and as a table."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import filterfalse
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from tyro.conf import Positional, arg

from getagrip.batch.scheduling import KeepOptions
from getagrip.cli.command import ClipsFolder, Command, Workers, failed_path_outcome
from getagrip.cli.evaluate import is_batch_file, missing_result_error
from getagrip.errors import InputError, UsageError, escape_unprintable
from getagrip.io.options import Flag, OptionalFolder, place_argument
from getagrip.io.storage import Place
from getagrip.io.terminal import print_result, progress_bar

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.ledger import LedgerEntry
    from getagrip.report.pages import IndexRow

REPORT_PAGE, REPORT_PICTURE, REPORT_VIDEO, INDEX_PAGE = "report.html", "report.png", "report.mp4", "index.html"
MAX_RESULTS_DEPTH = 4
"""Depth up to which a folder is searched for results; a benchmark's are at depth 3."""
MAX_STATUS_ROWS = 40
"""Maximum number of rows of the status table; ``summary.csv`` has all clips."""
STATE_LABELS = {"failed": "failed", "done": "done", "open": "left"}
MAX_REASON_LENGTH = 100
"""Maximum number of letters of a reason in the status table."""
Reported: TypeAlias = "tuple[IndexRow, Outcome | None]"


@dataclass(frozen=True)
class ReportRequest:
    """A request to write pages and pictures of results."""

    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    mp4: Flag = False
    """Also write report.mp4, a film of the result over its images and from the side."""
    view: Annotated[str | None, arg(metavar="NAME")] = None
    """Show this view alone in the film, of a clip with views: a further camera by its name, or camera, the clip's own.
    """
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
        if self.request.view is not None and not self.request.mp4:
            raise UsageError("--view is of the film: say --mp4 as well")

    def run(self) -> int:
        """Write pages, pictures, films and indices of the paths; return 1 if any failed, else 0."""
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
    """A result to report on; ``root`` is the folder of the index, None for a result that the user names."""

    folder: Path
    root: Path | None
    request: ReportRequest

    @property
    def name(self) -> str:
        """Path relative to the index."""
        return "" if self.root is None else self.folder.relative_to(self.root).as_posix()


def find_result_folders(path: Path, may_lack: bool = False) -> list[Path]:
    """List the results anywhere in a folder, sorted. Raises ``InputError`` without any, unless it ``may_lack`` them."""
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
    """Write the pages of a result, and return its row of the index; a failure is returned, not raised."""
    try:
        return _write_result_pages(job), None
    except Exception as error:  # one result's failure must not end the others
        outcome = failed_path_outcome(job.folder, error)
        return _failed_result_row(job, outcome.message), outcome


def _write_result_pages(job: ReportJob) -> IndexRow:
    from getagrip.metrics.evaluate import evaluate, read_result_clip_masks
    from getagrip.report.pages import index_row, write_page
    from getagrip.report.pictures.result_picture import write_report
    from getagrip.report.pictures.result_view import View
    from getagrip.result import read_result_record

    folder, request = job.folder, job.request
    result, clip, masks = read_result_clip_masks(folder, request.clips)
    evaluation, view = evaluate(result, clip, masks), View.of(result, clip, masks)
    if job.root is None or not request.index_only:
        write_page(view, evaluation, read_result_record(folder), folder / REPORT_PAGE)
    if job.root is None:
        write_report(result, clip, masks, folder / REPORT_PICTURE, evaluation.metrics)
    if request.mp4:
        from getagrip.report.film import write_film

        write_film(view if request.view is None else view.seen_by(request.view), folder / REPORT_VIDEO)
    return request.keep.marked(index_row(job.name, view, evaluation, (folder / REPORT_PAGE).is_file()), result)


def _failed_result_row(job: ReportJob, problem: str) -> IndexRow:
    """Make the row of a result whose pages failed, from its own files if they are readable."""
    from getagrip.report.pages import IndexRow, index_row_without_clip
    from getagrip.result import read_result

    try:
        result, record = read_result(job.folder)
        return job.request.keep.marked(index_row_without_clip(job.name, result, record["metrics"], problem), result)
    except Exception:  # its files may hold anything
        return IndexRow(job.name, problem=problem, flags=("failed",))


def _report_folder(path: Path, request: ReportRequest, workers: int | None) -> list[Outcome]:
    """Report on all results in a folder, write the index with the ledger's other clips, and return failures."""
    from getagrip.batch.executor import PROCESS_DIED_TWICE, for_each_job
    from getagrip.batch.job import Outcome
    from getagrip.batch.ledger import open_existing_ledger
    from getagrip.batch.summary import SUMMARY_FILE, known_entries, row_without_result, write_summary_table
    from getagrip.report.pages import IndexRow, write_index

    with open_existing_ledger(path) as ledger:
        without = [] if ledger is None else [one for one in known_entries(ledger, path) if one.state != "done"]
        if ledger is not None:
            write_summary_table(ledger, path, path / SUMMARY_FILE, request.keep)
    jobs = [ReportJob(folder, path, request) for folder in find_result_folders(path, may_lack=bool(without))]

    def died(job: ReportJob) -> Reported:
        row = IndexRow(job.name, problem=PROCESS_DIED_TWICE, flags=("failed",))
        return row, Outcome(str(job.folder), "failed", PROCESS_DIED_TWICE)

    with progress_bar(counted=True) as bar:
        task = bar.add_task("results", total=len(jobs))
        ends = for_each_job(report_one, jobs, died, lambda _: bar.advance(task), workers)
    rows = [*(row for row, _ in ends), *map(row_without_result, without)]
    tables = sorted(file.name for file in (*path.glob("*.md"), *path.glob(SUMMARY_FILE)))
    write_index(rows, path.resolve().name, tables, path / INDEX_PAGE)
    return [problem for _, problem in ends if problem is not None]


@dataclass(frozen=True, kw_only=True)
class ViewResults(Command):
    """Play results and clips in 3D on a local page, which opens only at its secret address."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="PATH...", help_behavior_hint="")] = ()
    """Results, clips, or folders of them. Results of one clip are shown side by side; several clips are listed, the
    worst results first."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8770, or a free one)")] = None
    """Port of the page."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address on which the page is served. By default other machines cannot reach it: from them, forward the port with
    ssh -L (docs/view.md)."""

    def check(self) -> None:
        super().check()
        if not self.paths:
            raise UsageError("missing PATH: name at least one result, clip, or folder of them")

    def run(self) -> int:
        """Serve the page; return 1 if a path could not be read, else 0.

        Raises ``UsageError`` for a port in use or an address of another machine, ``InputError`` without readable paths.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.report.pages.viewer import ViewerLibrary, ViewerServer, group_entries

        print_result(f"reading {', '.join(map(str, self.paths))} ...")  # loading takes seconds
        problems: list[Exception] = []
        results, alone = find_results_and_clips(self.paths, problems)
        library = ViewerLibrary(group_entries(results, alone, self.clips, problems.append), problems.append)
        if library.first is None:
            if len(problems) > 1:
                print(f"{len(problems)} problems, of which the first is:", file=sys.stderr)
            raise problems[0]
        for problem in problems:
            print_outcome(failed_outcome("", problem), self.debug)
        with ViewerServer(library, self.port, self.host) as server:
            print(f"open {server.url}\nCtrl-C ends", flush=True)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                print()
        return 1 if problems else 0


def find_results_and_clips(paths: Sequence[Path], problems: list[Exception]) -> tuple[list[Path], list[Path]]:
    """List the results anywhere in paths, and the clips of paths without results; others go to ``problems``."""
    results, clips = list[Path](), list[Path]()
    for path in filterfalse(is_batch_file, paths):
        below = find_result_folders(path, may_lack=True) if path.is_dir() else []
        alone = [path] if (path / "clip.json").exists() else sorted(file.parent for file in path.glob("*/clip.json"))
        results += below
        clips += [] if below else alone
        if not below and not alone:
            got = "neither result.json nor clip.json in it or below" if path.is_dir() else "no such folder"
            problems.append(InputError(path, "", got, "a result, a clip, or a folder of them"))
    return results, clips


@dataclass(frozen=True, kw_only=True)
class Status(Command):
    """Print which clips of a reconstruct folder are done, failed and left, and write its summary.csv and index.html.

    Each clip is listed with its IOU and probabilities. Reconstruct may still be running.
    """

    folder: Annotated[Positional[Place], place_argument("DIR"), arg(metavar="DIR", help_behavior_hint="")]
    """The --out of reconstruct."""
    ledger: OptionalFolder = None
    """The --ledger of reconstruct, if it had one. It is not changed."""

    def run(self) -> int:
        """Print the states of clips. Raises ``InputError`` for a folder without ledger and results."""
        import heapq
        from collections import Counter

        from getagrip.batch.ledger import ledger_folder, open_existing_ledger
        from getagrip.batch.summary import known_entries, ledger_severity_key, write_summary
        from getagrip.io.terminal import print_note

        out, expected = self.folder, "the folder of results of getagrip reconstruct"
        if isinstance(out, Path) and not out.is_dir():
            raise InputError(out, "", "no such folder", expected)
        with open_existing_ledger(ledger_folder(out, self.ledger)) as ledger:
            states = Counter(entry.state for entry in known_entries(ledger, out))
            if not states:
                raise InputError(str(out), "", "neither a ledger nor a result", expected)
            _print_status_table(heapq.nsmallest(MAX_STATUS_ROWS, known_entries(ledger, out), key=ledger_severity_key))
            if (more := states.total() - MAX_STATUS_ROWS) > 0:
                print_result(f"and {more} more, in summary.csv")
            print_result(", ".join(f"{states[state]} {STATE_LABELS[state]}" for state in ("done", "failed", "open")))
            try:
                for path in write_summary(ledger, out):
                    print_result(str(path))
            except OSError as error:
                print_note(f"no summary is written: {error}")
        return 0


def _print_status_table(entries: list[LedgerEntry]) -> None:
    """Print a row for each clip: state, IOU and probabilities, or the reason of a failure."""
    from rich.text import Text

    from getagrip.batch.summary import PROBABILITY_KEYS, display_name, entry_number
    from getagrip.io.terminal import console, make_table
    from getagrip.result.findings import format_probability

    table = make_table()
    for heading in ("clip", "", "IOU", "right in the hand", "in the camera", ""):
        table.add_column(heading, justify="right" if heading.startswith(("IOU", "right", "in")) else "left")
    for entry in entries:
        iou, *right = (entry_number(entry, key) for key in ("iou", *PROBABILITY_KEYS))
        numbers = ["" if iou is None else f"{iou:.2f}", *("" if p is None else format_probability(p) for p in right)]
        why = "" if entry.state == "done" else entry.why
        why = why[:MAX_REASON_LENGTH] + "..." * (len(why) > MAX_REASON_LENGTH)
        name, reason = (Text(escape_unprintable(text)) for text in (display_name(entry), why))
        table.add_row(name, STATE_LABELS[entry.state], *numbers, reason)
    console().print(table)
