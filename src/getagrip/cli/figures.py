"""`getagrip figure`: what each kind of figure takes, as declared with what draws it.

Those modules load numpy and more. So this one is loaded when the command is called, not for `getagrip --help`.
"""

from __future__ import annotations

from dataclasses import dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, Union

from tyro.conf import arg, subcommand

from getagrip.cli.command import Command, Results
from getagrip.commands.figure import check_out, write_figure
from getagrip.io.arguments import File
from getagrip.pictures.figures import FIGURES, Kind

K = TypeVar("K", bound=Kind)


@dataclass(frozen=True, kw_only=True)
class DrawFigure(Command, Generic[K]):
    """Draw a figure of results."""

    results: Results = ()
    """Result folders, or folders of results; contact and aligned also draw the ground truth of a clip's folder."""
    kind: Annotated[K, arg(name="")]
    out: File
    """The figure: .png or .pdf."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where they were made from)")] = None
    """A clip, or the folder that holds the clips by name."""

    def check(self) -> None:
        check_out(self.out)
        self.kind.check()

    def run(self) -> int:
        return write_figure(self.kind, self.results, self.clips, self.out, self.debug)


def _subcommands() -> Any:
    """A subcommand for each kind."""
    kinds = [
        Annotated[DrawFigure[kind], subcommand(name, description=cleandoc(kind.__doc__ or ""))]  # type: ignore[valid-type]
        for name, kind in FIGURES.items()
    ]
    return Union[tuple(kinds)]  # noqa: UP007


Figures = _subcommands()
