"""Work on each of some clips, on several cores, while a bar shows it: of segment and study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from getagrip.batch.share import FEW
from getagrip.errors import UsageError
from getagrip.io.terminal import progress_bar, show_stage

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from getagrip.batch.job import Outcome


class ClipJob(Protocol):
    """Something to do with a clip."""

    @property
    def clip(self) -> Path: ...


J = TypeVar("J", bound=ClipJob)
R = TypeVar("R")


def each_clip(
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
    from getagrip.batch.clips import print_outcome
    from getagrip.batch.job import Outcome
    from getagrip.batch.plan import by_name

    if not paths:
        raise UsageError("CLIP: name at least one clip")
    if workers is not None and workers < 1:
        raise UsageError(f"--workers must be 1 or more (got {workers})")
    clips, failed = by_name(paths)
    for outcome in failed:
        print_outcome(outcome, debug)
    jobs = [made for name, folder in clips.items() if (made := job(name, folder)) is not None]
    done: dict[Path, R] = {}
    with progress_bar() as bar:
        for one, result in _outcomes(work, jobs, workers, bar):
            if isinstance(result, Outcome):
                print_outcome(result, debug)
            else:
                done[one.clip] = result
    found = [done[one.clip] for one in jobs if one.clip in done]
    return found, len(failed) + len(jobs) - len(found)


def _outcomes(
    work: Callable[..., R | Outcome], jobs: Sequence[J], workers: int | None, bar: Bar
) -> Iterator[tuple[J, R | Outcome]]:
    """Yield the outcome of each job, as they finish, while the bar shows it."""
    from getagrip.batch.job import Outcome
    from getagrip.batch.pool import DIED, cores, in_processes

    if workers is None:
        workers = min(len(jobs), cores()) if len(jobs) > FEW else 1
    clips = bar.add_task("clips", total=len(jobs), visible=len(jobs) > 1)
    if workers > 1:
        for job, outcome in in_processes(work, jobs, workers):
            died = Outcome(job.clip.name, "failed", DIED)
            yield job, died if outcome is None else outcome
            bar.advance(clips)
        return
    stage = bar.add_task("", total=1.0, visible=bool(jobs))
    for job in jobs:
        yield job, work(job, partial(show_stage, bar, stage, job.clip.name))
        bar.advance(clips)
