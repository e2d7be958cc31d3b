"""`getagrip status` and `getagrip report`: what has become of clips, and results as pages, pictures and films."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.cli.command import ClipsFolder, Command, Workers
from getagrip.errors import UsageError
from getagrip.io.arguments import Flag, OptionalFolder, placed
from getagrip.io.storage import Place


@dataclass(frozen=True, kw_only=True)
class Status(Command):
    """Print what is done, failed and left of a folder that reconstruct is or was at work on, with each clip's IOU and
    probabilities; write its summary.csv and index.html."""

    folder: Annotated[Positional[Place], placed("DIR"), arg(metavar="DIR", help_behavior_hint="")]
    """What reconstruct was given as --out."""
    ledger: OptionalFolder = None
    """The folder of its ledger, where reconstruct was given one."""

    def run(self) -> int:
        from getagrip.commands.status import status

        return status(self.folder, self.ledger)


@dataclass(frozen=True, kw_only=True)
class Report(Command):
    """Write pages of results, report.html, that play in 3D without a network; for a folder of them index.html, too."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="PATH...", help_behavior_hint="")] = ()
    """Result folders, which get report.png as well, or folders that hold results."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    mp4: Flag = False
    """Write report.mp4, too, a film of the result over its images and from the side."""
    index_only: Flag = False
    """Of a folder of results only the index, with links to pages that are there already."""
    workers: Workers = None
    """Processes to share the results between."""

    def check(self) -> None:
        super().check()
        if not self.paths:
            raise UsageError("PATH: name at least one result, or a folder of results")
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers: got {self.workers}, expected 1 or more")

    def run(self) -> int:
        from getagrip.commands.report import ReportRequest, report

        return report(self.paths, ReportRequest(self.clips, self.mp4, self.index_only), self.workers, self.debug)
