"""The command that shows results and clips in 3D."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.cli.command import ClipsFolder, Command
from getagrip.errors import UsageError
from getagrip.io.terminal import say


@dataclass(frozen=True, kw_only=True)
class View(Command):
    """Look at results and clips in 3D, moving, on a page that only those who have its address can open."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="PATH...", help_behavior_hint="")] = ()
    """Results, clips, or folders of them. Results of one clip stand side by side; several clips are listed, the worst
    results first."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8770, or a free one)")] = None
    """Where the page is served."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """The address of this machine that the page is served at. By default other machines cannot reach it: forward the
    port with ssh -L (docs/view.md)."""

    def check(self) -> None:
        super().check()
        if not self.paths:
            raise UsageError("PATH: name at least one result, clip, or folder of them")

    def run(self) -> int:
        say(f"reading {', '.join(map(str, self.paths))} ...")  # to load what draws takes seconds, too
        from getagrip.commands.view import view

        return view(self.paths, self.clips, self.port, self.host, self.debug)
