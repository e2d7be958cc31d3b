"""``getagrip view``: results in 3D on a local page, until it is interrupted."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import filterfalse
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failure
from getagrip.commands.evaluate import of_batch
from getagrip.commands.report import results_below
from getagrip.errors import InputError
from getagrip.pages.entries import entries
from getagrip.pages.served import Library
from getagrip.pages.server import Server


def view(paths: Sequence[Path], clips: Path | None, port: int | None, host: str, debug: bool) -> int:
    """Serve the page; 1 if any of the paths could not be read, else 0.

    Raises ``UsageError`` for a port that is taken or an address that is not this machine's, and ``InputError`` where
    nothing can be shown.
    """
    problems: list[Exception] = []
    results, alone = found(paths, problems)
    library = Library(entries(results, alone, clips, problems.append), problems.append)
    if library.first is None:
        if len(problems) > 1:
            print(f"{len(problems)} problems, of which the first is:", file=sys.stderr)
        raise problems[0]
    for problem in problems:
        print_outcome(failure("", problem), debug)
    with Server(library, port, host) as server:
        print(f"open {server.url}\nCtrl-C ends", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return 1 if problems else 0


def found(paths: Sequence[Path], problems: list[Exception]) -> tuple[list[Path], list[Path]]:
    """The folders of results anywhere below paths, and of clips where there are no results."""
    results: list[Path] = []
    clips: list[Path] = []
    for path in filterfalse(of_batch, paths):
        below = results_below(path, may_lack=True) if path.is_dir() else []
        alone = [path] if (path / "clip.json").exists() else sorted(file.parent for file in path.glob("*/clip.json"))
        results += below
        clips += [] if below else alone
        if not below and not alone:
            given = "neither result.json nor clip.json in it or below" if path.is_dir() else "no such folder"
            problems.append(InputError(path, "", given, "a result, a clip, or a folder of them"))
    return results, clips
