"""``getagrip figure``: a figure of results, written whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failure
from getagrip.commands.evaluate import results_in
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.view.figures import GivenResult, Kind
from getagrip.view.given import is_clip
from getagrip.view.style import letters

SUFFIXES = (".png", ".pdf")


def check_out(out: Path) -> None:
    """Raise ``UsageError`` for a file that no figure can be written to."""
    if out.suffix.lower() not in SUFFIXES:
        raise UsageError(f"--out: got {out}, expected a file whose name ends in {' or '.join(SUFFIXES)}")
    files.check_file("--out", out)


def write_figure(kind: Kind, paths: Sequence[Path], clips: Path | None, out: Path, debug: bool) -> int:
    """Draw results into a file; 1 if any could not be read, else 0. A path is a result, or a folder of results; or a
    clip, where the kind draws the ground truth.

    Raises ``UsageError`` where there are none or too many for this kind, ``InputError`` where none can be shown.
    """
    if not paths:
        raise UsageError("RESULT: name at least one result")
    given: list[GivenResult] = []
    problems: list[Exception] = []
    for path in paths:
        try:
            folders = [path] if kind.draws_truth and is_clip(path) else results_in(path)
            given += [GivenResult(folder, clips) for folder in folders]
        except (InputError, OSError) as error:
            if len(paths) == 1:
                raise
            problems.append(error)
    with letters():
        figure = kind.draw(given, problems.append)
        form = out.suffix.lower()[1:]
        undated = {"CreationDate": None} if form == "pdf" else {"Software": None}  # the same picture, the same file
        with files.new_file(out) as part:
            figure.savefig(part, format=form, dpi=kind.dpi, metadata=undated)
    for problem in problems:
        print_outcome(failure("", problem), debug)
    print(out)
    return 1 if problems else 0
