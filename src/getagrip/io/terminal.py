"""Output on a terminal or into a pipe: tables, a progress bar, numbers of things in words."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal, TypeAlias

from getagrip.errors import escape_unprintable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table

Progressed: TypeAlias = Callable[[str, float], None] | bool | None
"""Progress as public functions take it (``progress_callback``)."""
PIPE_WIDTH = 200
"""Columns of a pipe, which has no width of its own: enough for every table."""


PROGRESS_LINE_WIDTH = 70
"""Letters of a line that the next one overwrites."""


class NullOutput(io.TextIOBase):
    """Standard output under ``--quiet``, which shows neither text nor progress bars."""

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        return len(text)


def print_note(words: str) -> None:
    """Print a note, apart from the results; what files say in it moves no cursor."""
    print(escape_unprintable(words), file=sys.stderr)


_collected_warnings: ContextVar[list[str] | None] = ContextVar("_kept", default=None)
"""The list that warnings are added to instead of being printed; None: they are printed."""


def warn(words: str) -> None:
    """Print a warning, or keep it, within ``collect_warnings``."""
    kept = _collected_warnings.get()
    if kept is None:
        print_note(f"warning: {words}")
    else:
        kept.append(words)


@contextmanager
def collect_warnings() -> Iterator[list[str]]:
    """Keep warnings in a list instead of printing them."""
    warnings = list[str]()
    token = _collected_warnings.set(warnings)
    try:
        yield warnings
    finally:
        _collected_warnings.reset(token)


def print_result(words: str) -> None:
    """Print a result at once; names in it move no cursor, and lines stay lines."""
    print(escape_unprintable(words, "\n"), flush=True)


def console() -> Console:
    """Make the console on which tables are printed."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)


def make_table(
    title: str | None = None, title_style: str | None = None, title_justify: Literal["left", "center"] = "center"
) -> Table:
    """Make an empty table, its only line below the headings."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(
        box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
        title=title, title_style=title_style, title_justify=title_justify,
    )  # fmt: skip


def _in_notebook() -> bool:
    from rich.console import Console

    return Console().is_jupyter


@contextmanager
def progress_bar(counted: bool = False) -> Iterator[Progress]:
    """Show a bar on stderr, where that is a terminal; ``format_count`` adds the counts and the time left."""
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
    stderr = Console(stderr=True)
    in_notebook = _in_notebook() and find_spec("ipywidgets") is not None  # rich draws by it there
    with Progress(
        *columns,
        console=stderr,
        disable=not (stderr.is_terminal or in_notebook) or isinstance(sys.stdout, NullOutput),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # else what is printed would leave a pipe for the terminal
        speed_estimate_period=600.0,  # a clip takes seconds: the default of half a minute holds only a few
    ) as bar:
        yield bar


def show_stage(bar: Progress, task: TaskID, name: str, stage: str, part: float) -> None:
    """Show how far the clip at work is: its stage in words, and how much of that is done, 0 to 1."""
    bar.update(task, description=escape_unprintable(f"{name}: {stage}"), completed=part)


@contextmanager
def progress_callback(progress: Progressed, name: str) -> Iterator[Callable[[str, float], None] | None]:
    """Give the function that is called with a stage in words and how much is done, 0 to 1.

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
    """Write a count, such as "1 clip" or "2 clips"; ``things`` is the plural where it takes more than an s."""
    return f"{number} {thing if number == 1 else things or f'{thing}s'}"


def format_ranges(frames: Sequence[int], counted_from: int) -> str:
    """Write which frames, such as "3 to 7, 12"; the first frame has the number ``counted_from``."""
    runs: list[list[int]] = []
    for n in frames:
        if runs and n == runs[-1][1] + 1:
            runs[-1][1] = n
        else:
            runs.append([n, n])
    numbers = ((a + counted_from, b + counted_from) for a, b in runs)
    return ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in numbers)
