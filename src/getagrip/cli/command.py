"""The base of all commands: types of arguments, checks before any work, and work on each of several clips.

A command is a frozen dataclass of options with the body that runs them, in one file. ``getagrip --help`` loads the
files of all commands but ``import`` and ``figure``: libraries that only a body needs are imported in the body.
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

from getagrip.errors import InputError, UsageError, escape_unprintable
from getagrip.io.options import Flag, one_of, place_argument
from getagrip.io.storage import Place, RemotePath
from getagrip.io.terminal import NullOutput, progress_bar, show_stage

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome

WARNING_EXIT_STATUS = 3
"""Exit status where output was written, and part of it is assumed, missing or probably wrong."""
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
        """Run the command, and return the exit status."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ``UsageError``, before any work is done, for an output that cannot be written."""
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


def refuse_existing(target: Path, overwrite: bool) -> None:
    """Raise ``UsageError`` for an output that exists, unless it may be overwritten."""
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; --overwrite replaces it")


def failed_path_outcome(path: Path, error: Exception) -> Outcome:
    """Make the outcome of a file or folder that failed; an ``InputError`` names its path itself."""
    from getagrip.batch.job import failed_outcome

    return failed_outcome("" if isinstance(error, InputError) else str(path), error)


class ClipJob(Protocol):
    """The work of a command on one clip."""

    @property
    def clip(self) -> Path: ...


J = TypeVar("J", bound=ClipJob)
R = TypeVar("R")


def for_each_clip(
    paths: Sequence[Path],
    job: Callable[[str, Path], J],
    work: Callable[..., R],
    workers: int | None,
    debug: bool,
) -> tuple[list[R], int]:
    """Do the work for each clip; print failures, and return the values in order and the number of failures.

    A path is a clip, or a folder of clips; ``job`` makes a job of a clip's name and folder. ``work`` takes a job and,
    in this process only, a function that it calls with its progress; an exception fails that clip alone. Raises
    ``UsageError`` without paths.
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
    jobs = [job(name, folder) for name, folder in clips.items()]
    attempt = partial(_attempt, work)

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
            return attempt(one, partial(show_stage, bar, stage, one.clip.name))

        results = for_each_job(attempt, jobs, died, ended, workers, here)
    found = [result for result in results if not isinstance(result, Outcome)]
    return found, len(failed) + len(jobs) - len(found)


def _attempt(work: Callable[..., R], job: J, *progress: Callable[[str, float], None]) -> R | Outcome:
    from getagrip.batch.job import failed_outcome

    try:
        return work(job, *progress)
    except Exception as error:  # one clip's failure must not end the others
        return failed_outcome(job.clip.name, error)
