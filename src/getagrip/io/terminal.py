"""Text for people: notes and warnings, progress bars, tables (terminal, CSV, Markdown); and the user's own folders.

Spreadsheets run a cell that begins with ``=``, ``+``, ``-``, ``@`` or a control character as a formula. Names come
from untrusted files: such a text gets an apostrophe in front, which spreadsheets hide and ``files.csv_rows`` removes.
Numbers are written unchanged.
"""

from __future__ import annotations

import csv
import io
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TextIO, TypeAlias, cast

from getagrip.errors import UsageError, escape_unprintable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table


def cache_folder() -> Path:
    """Return the folder of data that can be made again. Raises ``UsageError`` for a user without a home folder."""
    return _xdg_folder("XDG_CACHE_HOME", ".cache")


def state_folder() -> Path:
    """Return the folder of data worth keeping. Raises ``UsageError`` for a user without a home folder."""
    return _xdg_folder("XDG_STATE_HOME", ".local/state")


def _xdg_folder(variable: str, below_home: str) -> Path:
    try:
        return Path(os.environ.get(variable) or Path.home() / below_home) / "getagrip"
    except RuntimeError as error:  # as in a container, for an unknown user
        raise UsageError(f"missing HOME or {variable}: this user has no home folder") from error


def is_private_folder(folder: Path) -> bool:
    """Return whether only this user and root can write into a folder, or replace it."""
    if os.name == "nt":
        return True
    whole, real = folder.absolute(), folder.resolve()
    return all(_is_protected_path(path, path == real) for path in {whole, *whole.parents, real, *real.parents})


def _is_protected_path(path: Path, last: bool) -> bool:
    """Return whether only this user and root can replace a path's target; nor add entries, in the ``last`` folder."""
    try:
        about = path.lstat()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    if about.st_uid not in (0, os.geteuid()):
        return False
    writers = stat.S_IWOTH | (0 if _is_private_group(about.st_gid, about.st_uid) else stat.S_IWGRP)
    sticky = bool(about.st_mode & stat.S_ISVTX) and not last  # only an entry's owner removes it
    return stat.S_ISLNK(about.st_mode) or sticky or not about.st_mode & writers


def _is_private_group(group: int, owner: int) -> bool:
    """Return whether a group is named after its owner, and has no other member."""
    try:
        import grp
        import pwd

        found, name = grp.getgrgid(group), pwd.getpwuid(owner).pw_name
    except (ImportError, KeyError):
        return False
    return found.gr_name == name and {*found.gr_mem} <= {name}


Progressed: TypeAlias = Callable[[str, float], None] | bool | None
"""Progress argument of public functions (``progress_callback``)."""
PIPE_WIDTH = 200
"""Width assumed for a pipe [characters]: enough for every table."""
PROGRESS_LINE_WIDTH = 70
"""Width of a progress line, which the next one overwrites [characters]."""


class NullOutput(io.TextIOBase):
    """Standard output under ``--quiet``: neither text nor progress bars."""

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        return len(text)


def print_note(words: str) -> None:
    """Print a note to stderr; quoted file content cannot move the cursor."""
    print(escape_unprintable(words), file=sys.stderr)


_collected_warnings: ContextVar[list[str] | None] = ContextVar("_collected_warnings", default=None)
"""List that collects warnings; None: warnings are printed."""


def warn(words: str) -> None:
    """Print a warning, or collect it within ``collect_warnings``."""
    collected = _collected_warnings.get()
    if collected is None:
        print_note(f"warning: {words}")
    else:
        collected.append(words)


@contextmanager
def collect_warnings() -> Iterator[list[str]]:
    """Collect warnings in a list instead of printing them."""
    warnings = list[str]()
    token = _collected_warnings.set(warnings)
    try:
        yield warnings
    finally:
        _collected_warnings.reset(token)


def print_result(words: str) -> None:
    """Print a result at once, line breaks kept; names in it cannot move the cursor."""
    print(escape_unprintable(words, "\n"), flush=True)


def console() -> Console:
    """Make the console for tables."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)


def make_table(
    title: str | None = None, title_style: str | None = None, title_justify: Literal["left", "center"] = "center"
) -> Table:
    """Make an empty table with a single rule, below the headings."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(
        box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
        title=title, title_style=title_style, title_justify=title_justify,
    )  # fmt: skip


def _in_notebook() -> bool:
    from rich.console import Console

    return Console().is_jupyter


class _HiddenProgress:
    """A bar that is not shown. The one that is takes a tenth of a second to load."""

    disable = True

    def add_task(self, *_: object, **__: object) -> int:
        return 0

    def update(self, *_: object, **__: object) -> None:
        """Show nothing."""

    advance = remove_task = update


def _may_show_bar() -> bool:
    """Return whether stderr may be a terminal or a notebook, or one is asked for, as rich has it."""
    asked = not {"FORCE_COLOR", "TTY_COMPATIBLE"}.isdisjoint(os.environ)
    return asked or sys.stderr.isatty() or "IPython" in sys.modules


@contextmanager
def progress_bar(counted: bool = False) -> Iterator[Progress]:
    """Show a bar on stderr if it is a terminal; ``counted`` adds the counts and the time left."""
    if not _may_show_bar():
        yield cast("Progress", _HiddenProgress())
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: list[ProgressColumn] = [TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn()]
    if counted:
        columns += [MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn()]
    stderr = Console(file=sys.stderr, stderr=True)  # this stream, even if sys.stderr is replaced later
    in_notebook = _in_notebook() and find_spec("ipywidgets") is not None  # rich draws with it
    with Progress(
        *columns,
        console=stderr,
        disable=not (stderr.is_terminal or in_notebook) or isinstance(sys.stdout, NullOutput),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # else prints would leave a pipe for the terminal
        speed_estimate_period=600.0,  # a clip takes seconds: the default, half a minute, averages only a few
    ) as bar:
        yield bar


def show_stage(bar: Progress, task: TaskID, name: str, stage: str, part: float) -> None:
    """Show the current clip's stage in words, and the fraction done, 0 to 1."""
    bar.update(task, description=escape_unprintable(f"{name}: {stage}"), completed=part)


@contextmanager
def progress_callback(progress: Progressed, name: str) -> Iterator[Callable[[str, float], None] | None]:
    """Give the function to call with a stage in words and the fraction done, 0 to 1.

    True shows a bar on a terminal or in a notebook; False and None show nothing.
    """
    if progress is True and _in_notebook() and find_spec("ipywidgets") is None:
        yield lambda stage, part: print(f"\r{part:4.0%} {name}: {stage}".ljust(PROGRESS_LINE_WIDTH), end="", flush=True)
        print()
    elif progress is True:
        with progress_bar() as bar:
            yield partial(show_stage, bar, bar.add_task(name, total=1.0), name)
    else:
        yield progress or None


def format_count(number: int, thing: str, things: str = "") -> str:
    """Write a count, such as "1 clip" or "2 clips"; ``things`` is an irregular plural."""
    return f"{number} {thing if number == 1 else things or f'{thing}s'}"


def format_ranges(frames: Sequence[int], counted_from: int) -> str:
    """Write frame numbers, such as "3 to 7, 12"; the first frame has the number ``counted_from``."""
    runs: list[list[int]] = []
    for n in frames:
        if runs and n == runs[-1][1] + 1:
            runs[-1][1] = n
        else:
            runs.append([n, n])
    numbers = ((a + counted_from, b + counted_from) for a, b in runs)
    return ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in numbers)


_FORMULA_PATTERN = re.compile(r"'*[=+\-@\t\r\n]")
"""Start of a text that gets an apostrophe; leading apostrophes get one more, so that reading undoes it."""


class CsvTable:
    """A CSV table, written into a text stream that was opened with ``newline=""``."""

    def __init__(self, stream: TextIO) -> None:
        self._rows = csv.writer(stream)

    def write_row(self, cells: Iterable[object]) -> None:
        """Add a row: texts escaped against formulas, numbers unchanged."""
        self._rows.writerow([escape_cell(cell) if isinstance(cell, str) else cell for cell in cells])

    def write_rows(self, rows: Iterable[Iterable[object]]) -> None:
        """Add rows."""
        for cells in rows:
            self.write_row(cells)


def escape_cell(text: str) -> str:
    """Escape a text for a cell."""
    return f"'{text}" if _FORMULA_PATTERN.match(text) else text


def unescape_cell(cell: str) -> str:
    """Return the text of a cell that ``escape_cell`` wrote; other cells stay unchanged."""
    return cell[1:] if cell.startswith("'") and _FORMULA_PATTERN.match(cell) else cell


def markdown_page(title: str, grid: Sequence[Sequence[str]], about: Sequence[str], words: int = 1) -> str:
    """Write a page: title, table (``words`` columns of words, then numbers), and how it was made."""
    lines = [f"# {title}", "", *markdown_table(grid, words), "", *(f"- {line}" for line in about)]
    return "\n".join(lines) + "\n"


def markdown_table(grid: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """Return the lines of a table, headings first: ``words`` columns of words, then numbers."""
    headings, *body = grid
    rule = [*["---"] * words, *["---:"] * (len(headings) - words)]
    escaped = ([cell.replace("|", "\\|") for cell in cells] for cells in (headings, rule, *body))
    return [f"| {' | '.join(cells)} |" for cells in escaped]
