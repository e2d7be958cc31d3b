"""``getagrip view``: results in 3D on a local page, until it is interrupted."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import filterfalse
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failure
from getagrip.commands.evaluate import of_batch
from getagrip.errors import InputError
from getagrip.pages.entries import entries
from getagrip.pages.served import Library
from getagrip.pages.server import Server

RESULTS, CLIPS = ("", "*", "*/*"), ("", "*")
"""Where results and clips are looked for below a path: a result, results, results of several methods."""


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
    """The folders of results, and of clips where there are no results, that paths stand for."""
    results: list[Path] = []
    clips: list[Path] = []
    for path in filterfalse(of_batch, paths):
        below = [sorted(file.parent for file in path.glob(f"{depth}/result.json".lstrip("/"))) for depth in RESULTS]
        alone = [sorted(file.parent for file in path.glob(f"{depth}/clip.json".lstrip("/"))) for depth in CLIPS]
        if any(below):
            results += next(folders for folders in below if folders)
        elif any(alone):
            clips += next(folders for folders in alone if folders)
        else:
            given = "neither result.json nor clip.json in it or below" if path.is_dir() else "no such folder"
            problems.append(InputError(path, "", given, "a result, a clip, or a folder of them"))
    return results, clips
