"""What all commands share: the ways arguments are written, and checks before any work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.errors import UsageError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import GivenMasks, GivenMesh, Hands, Init, PriorsFile
from getagrip.io.arguments import Flag, numbers, one_of, placed
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
Seed = Annotated[int, arg(metavar="S")]
Inits = Annotated[int, arg(metavar="N")]
if TYPE_CHECKING:
    Method = str
else:
    Method = Literal[tuple(METHODS)]
Intrinsics = Annotated[
    tuple[float, float, float, float] | None, numbers(4, "FX FY CX CY"), arg(name="K", help_behavior_hint="")
]
Focal = Annotated[float | None, arg(metavar="PX", help_behavior_hint="")]
OptionalSide = Annotated[Literal["left", "right"] | None, one_of("left", "right"), arg(help_behavior_hint="")]
Labels = Annotated[tuple[str, ...], arg(metavar="LABEL...", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes."""

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


def hands_of(given: bool) -> Hands:
    """The option of the name."""
    return "as-given" if given else "corrected"


def masks_of(given: bool) -> GivenMasks:
    """Likewise, of the masks."""
    return "as-given" if given else "checked"


def mesh_of(given: bool) -> GivenMesh:
    """Likewise, of the mesh."""
    return "as-given" if given else "fitted"


def priors_of(path: Path | None, init: Init, alone: bool) -> PriorsFile | None:
    """The starting poses that the user names, identified."""
    if init == "uniform" and alone:
        raise UsageError("--priors-only: got it with uniform rotations only, expected --init clusters or priors")
    if init == "uniform" and path is not None:
        raise UsageError(f"--priors: got {path}, expected none without --init clusters or priors")
    if path is None:
        if init != "uniform":
            raise UsageError(f"--priors: got nothing, expected a file or folder for --init {init}")
        return None
    from getagrip.fitting import pose_priors as priors

    return priors.given(path, init, alone)
