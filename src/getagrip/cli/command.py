"""The base of all commands: the forms of arguments, checks before any work, and work on each of some clips.

A command is a frozen dataclass of options and the body that runs them, in one file. The files of all commands but
``import`` and ``figure`` are loaded for ``getagrip --help``: what only the body needs is imported in it.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Protocol, TypeVar, final

from tyro.conf import Positional, arg

from getagrip.errors import UsageError, escape_unprintable
from getagrip.io.options import Flag, one_of, place_argument
from getagrip.io.storage import Place, RemotePath
from getagrip.io.terminal import NullOutput, progress_bar, show_stage

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome

Clips = Annotated[Positional[tuple[Path, ...]], arg(metavar="CLIP...", help_behavior_hint="")]
Sources = Annotated[
    Positional[tuple[Annotated[Place, place_argument("CLIP")], ...]], arg(metavar="CLIP...", help_behavior_hint="")
]
Results = Annotated[Positional[tuple[Path, ...]], arg(metavar="RESULT...", help_behavior_hint="")]
ClipsFolder = Annotated[
    Path | None, arg(metavar="DIR", help_behavior_hint="(default: where the results were made from)")
]
Workers = Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core for more than 3 clips)")]
OptionalSide = Annotated[Literal["left", "right"] | None, one_of("left", "right"), arg(help_behavior_hint="")]
FirstNumber = Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")]
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
        """Raise ``UsageError``, before any work is done, where an output cannot be written."""
        from getagrip.io import files

        if isinstance(out := getattr(self, "out", None), RemotePath):
            out.check_writable("--out")
        elif out is not None:
            files.check_folder("--out", out)
        if (json := getattr(self, "json", None)) is not None:
            files.check_file("--json", json)

    @final
    def run_checked(self) -> int:
        """Check the options, then run, without output if ``quiet``. Returns the exit status."""
        self.check()
        with redirect_stdout(NullOutput()) if self.quiet else nullcontext():
            return self.run()


def print_error(error: Exception, debug: bool) -> int:
    """Print an error that ends a command, after its traceback with ``debug``. Returns the exit status."""
    if debug:
        print(escape_unprintable(traceback.format_exc(), "\n"), file=sys.stderr)
    print(f"getagrip: {escape_unprintable(str(error))}", file=sys.stderr)
    return 2 if isinstance(error, UsageError) else 1


class ClipJob(Protocol):
    """The work of a command on one clip."""

    @property
    def clip(self) -> Path: ...


J = TypeVar("J", bound=ClipJob)
R = TypeVar("R")


def for_each_clip(
    paths: Sequence[Path],
    job: Callable[[str, Path], J | None],
    work: Callable[..., R | Outcome],
    workers: int | None,
    debug: bool,
) -> tuple[list[R], int]:
    """Do the work for each clip; return the values in order, and how many failed, which is printed.

    A path is a clip, or a folder of clips; ``job`` makes one of a clip's name and folder, or None for clips to be
    passed over. ``work`` takes a job and, where it is done in this process, a function to call with its progress.
    Raises ``UsageError`` where no path is given.
    """
    from getagrip.batch.clips import clips_by_name, print_outcome
    from getagrip.batch.executor import PROCESS_DIED_TWICE, for_each_job
    from getagrip.batch.job import Outcome

    if not paths:
        raise UsageError("missing CLIP: name at least one clip")
    if workers is not None and workers < 1:
        raise UsageError(f"--workers must be 1 or more (got {workers})")
    clips, failed = clips_by_name(paths)
    for outcome in failed:
        print_outcome(outcome, debug)
    jobs = [made for name, folder in clips.items() if (made := job(name, folder)) is not None]

    def died(one: J) -> R | Outcome:
        return Outcome(one.clip.name, "failed", PROCESS_DIED_TWICE)

    def ended(result: R | Outcome) -> None:
        if isinstance(result, Outcome):
            print_outcome(result, debug)
        bar.advance(task)

    with progress_bar() as bar:
        task = bar.add_task("clips", total=len(jobs), visible=len(jobs) > 1)
        stage = bar.add_task("", total=1.0, visible=False)

        def here(one: J) -> R | Outcome:
            bar.update(stage, visible=True)
            return work(one, partial(show_stage, bar, stage, one.clip.name))

        results = for_each_job(work, jobs, died, ended, workers, here)
    found = [result for result in results if not isinstance(result, Outcome)]
    return found, len(failed) + len(jobs) - len(found)
