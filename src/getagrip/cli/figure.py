"""``getagrip figure``: figures of results, a subcommand for each kind.

The options of a kind are declared in the module that draws it. These modules load numpy and more: this module is loaded
for the command only, not for ``getagrip --help``.
"""

from __future__ import annotations

from dataclasses import dataclass
from inspect import cleandoc
from typing import Annotated, Generic, TypeVar, Union

from tyro.conf import arg, subcommand

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failed_outcome
from getagrip.bench.figures import FIGURES, FigureKind, StoredResult
from getagrip.cli.command import ClipsFolder, Command, Results
from getagrip.cli.evaluate import list_result_folders
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.options import File
from getagrip.report.pictures.panels import figure_style
from getagrip.report.pictures.stored_results import is_clip

FIGURE_SUFFIXES = (".png", ".pdf")

K = TypeVar("K", bound=FigureKind)


@dataclass(frozen=True, kw_only=True)
class DrawFigure(Command, Generic[K]):
    """Draw a figure of results."""

    results: Results = ()
    """Result folders, or folders of results; contact and aligned also draw the ground truth of a clip's folder."""
    kind: Annotated[K, arg(name="")]
    out: File
    """The figure: .png or .pdf."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""

    def check(self) -> None:
        if self.out.suffix.lower() not in FIGURE_SUFFIXES:
            raise UsageError(f"--out must be a file whose name ends in {' or '.join(FIGURE_SUFFIXES)} (got {self.out})")
        files.check_file("--out", self.out)
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")
        self.kind.check()

    def run(self) -> int:
        """Draw results into a file; return 1 if any could not be read, else 0.

        Raises ``UsageError`` for more results than the kind takes, ``InputError`` if no result can be drawn.
        """
        stored, problems = list[StoredResult](), list[Exception]()
        for path in self.results:
            try:
                folders = [path] if self.kind.draws_truth and is_clip(path) else list_result_folders(path)
                stored += [StoredResult(folder, self.clips) for folder in folders]
            except (InputError, OSError) as error:
                if len(self.results) == 1:
                    raise
                problems.append(error)
        with figure_style():
            figure = self.kind.draw(stored, problems.append)
            form = self.out.suffix.lower()[1:]
            undated = {"CreationDate": None} if form == "pdf" else {"Software": None}  # equal pictures are equal files
            with files.new_file(self.out) as part:
                figure.savefig(part, format=form, dpi=self.kind.dpi, metadata=undated)
        for problem in problems:
            print_outcome(failed_outcome("", problem), self.debug)
        print(self.out)
        return 1 if problems else 0


def _figure_subcommands() -> object:
    kinds = [
        Annotated[DrawFigure[kind], subcommand(name, description=cleandoc(kind.__doc__ or ""))]  # type: ignore[valid-type]
        for name, kind in FIGURES.items()
    ]
    return Union[tuple(kinds)]  # noqa: UP007


Figures = _figure_subcommands()
