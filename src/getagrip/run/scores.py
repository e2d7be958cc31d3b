"""``getagrip evaluate`` and ``getagrip report``: results against their clips."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from getagrip import files
from getagrip.clip import read_masks
from getagrip.errors import InputError, UsageError
from getagrip.evaluate import clip_of, evaluate_result, summary, tables
from getagrip.result import read_result
from getagrip.run.batch import progress_bar


def evaluate_results(paths: Sequence[Path], clips: Path | None, json: Path | None, debug: bool) -> int:
    """Print the metrics of results, and write them to a file; 1 if any result could not be evaluated, else 0.

    A path is a result, or a folder of results. Raises ``UsageError`` where there is nothing to do.
    """
    if not paths:
        raise UsageError("RESULT: name at least one result")
    evaluations = []
    failures = 0
    with progress_bar() as bar:
        task = bar.add_task("results", total=None)
        for path in paths:
            try:
                folders = results_in(path)
            except InputError as error:
                failures += _tell(error, debug)
                continue
            for folder in folders:
                try:
                    evaluations.append(evaluate_result(folder, clips))
                except InputError as error:
                    failures += _tell(error, debug)
                bar.advance(task)
    if evaluations:
        from rich.console import Console

        # A pipe has no width: give tables the one they need there.
        console = Console() if sys.stdout.isatty() else Console(width=200)
        for table in tables(evaluations):
            console.print(table)
    if json is not None:
        files.write_json(json, summary(evaluations))
    return 1 if failures else 0


def results_in(path: Path) -> list[Path]:
    """The result folders that a path stands for. Raises ``InputError`` where it holds none."""
    if (path / "result.json").exists():
        return [path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    results = sorted(found.parent for found in path.glob("*/result.json"))
    if not results:
        raise InputError(path, "", "no result.json in it or in its folders", "a result, or a folder of results")
    return results


def report_result(folder: Path) -> int:
    """Draw ``report.png`` into a result folder."""
    from getagrip.view.report import write_report

    result, record = read_result(folder)
    clip = clip_of(folder, result, record, None)
    masks = read_masks(clip) if (clip.folder / "masks" / "object").exists() else None
    metrics = evaluate_result(folder)["metrics"]
    print(write_report(clip, masks, result, folder / "report.png", metrics))
    return 0


def _tell(error: InputError, debug: bool) -> int:
    """One line on stderr for a result that could not be evaluated; counts as one."""
    print(f"failed: {error}", file=sys.stderr)
    if debug:
        traceback.print_exception(error)
    return 1
