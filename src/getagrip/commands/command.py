"""The base of all commands: the forms of arguments, and checks before any work.

A command is a frozen dataclass of options and the body that runs them, in one file. The files of all commands but
``import`` and ``figure`` are loaded for ``getagrip --help``: what only the body needs is imported in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.io.arguments import Flag, one_of, placed
from getagrip.io.storage import Place, Remote

Clips = Annotated[Positional[tuple[Path, ...]], arg(metavar="CLIP...", help_behavior_hint="")]
Sources = Annotated[
    Positional[tuple[Annotated[Place, placed("CLIP")], ...]], arg(metavar="CLIP...", help_behavior_hint="")
]
Results = Annotated[Positional[tuple[Path, ...]], arg(metavar="RESULT...", help_behavior_hint="")]
ClipsFolder = Annotated[
    Path | None, arg(metavar="DIR", help_behavior_hint="(default: where the results were made from)")
]
Workers = Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core for more than 3 clips)")]
OptionalSide = Annotated[Literal["left", "right"] | None, one_of("left", "right"), arg(help_behavior_hint="")]
Labels = Annotated[tuple[str, ...], arg(metavar="LABEL...", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Command:
    """The options of every command."""

    debug: Flag = False
    """Show where an error arose."""
    quiet: Flag = False
    """Print warnings and errors only."""

    def run(self) -> int:
        """Do it, and return the exit status."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ``UsageError`` where what it writes has no place, before any work is done."""
        from getagrip.io import files

        if isinstance(out := getattr(self, "out", None), Remote):
            out.check_writable("--out")
        elif out is not None:
            files.check_folder("--out", out)
        if (json := getattr(self, "json", None)) is not None:
            files.check_file("--json", json)
