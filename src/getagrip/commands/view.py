"""``getagrip view``: results in 3D on a local page, until it is interrupted."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import filterfalse
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.commands.command import ClipsFolder, Command
from getagrip.commands.evaluate import is_batch_file
from getagrip.commands.report import find_result_folders
from getagrip.errors import InputError, UsageError
from getagrip.io.terminal import print_result


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
        """Serve the page; 1 if any of the paths could not be read, else 0.

        Raises ``UsageError`` for a port that is taken or an address that is not this machine's, and ``InputError``
        where nothing can be shown.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.pages.served import ViewerLibrary, group_entries
        from getagrip.pages.server import ViewerServer

        print_result(f"reading {', '.join(map(str, self.paths))} ...")  # to load what draws takes seconds, too
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
    """List the folders of results anywhere below paths, and of clips where there are no results."""
    results: list[Path] = []
    clips: list[Path] = []
    for path in filterfalse(is_batch_file, paths):
        below = find_result_folders(path, may_lack=True) if path.is_dir() else []
        alone = [path] if (path / "clip.json").exists() else sorted(file.parent for file in path.glob("*/clip.json"))
        results += below
        clips += [] if below else alone
        if not below and not alone:
            got = "neither result.json nor clip.json in it or below" if path.is_dir() else "no such folder"
            problems.append(InputError(path, "", got, "a result, a clip, or a folder of them"))
    return results, clips
