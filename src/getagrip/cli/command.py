"""What all commands share: the ways arguments are written, and checks before any work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from getagrip.fitting.methods import METHODS

Clips = Annotated[Positional[tuple[Path, ...]], arg(metavar="CLIP...", help_behavior_hint="")]
Results = Annotated[Positional[tuple[Path, ...]], arg(metavar="RESULT...", help_behavior_hint="")]
Folder = Annotated[Path, arg(metavar="DIR")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path, arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Workers = Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core for more than 3 clips)")]
Seed = Annotated[int, arg(metavar="S")]
if TYPE_CHECKING:
    Method = str
else:
    Method = Literal[tuple(METHODS)]
Flag = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes."""

    debug: Flag = False
    """Show where an error arose."""

    def run(self) -> int:
        """Do it, and return the exit status."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ``UsageError`` where what it writes has no place, before any work is done."""
        from getagrip.io import files

        if (out := getattr(self, "out", None)) is not None:
            files.check_folder("--out", out)
        if (json := getattr(self, "json", None)) is not None:
            files.check_file("--json", json)
