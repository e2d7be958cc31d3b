"""``import hands DEMOS/ --clips CLIPS/``, and masks: what is named like a clip goes into it, for many clips."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.commands.command import Command, for_each_clip
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.terminal import NullOutput, collect_warnings, format_count, print_note, print_result

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome


@dataclass(frozen=True)
class ImportJob:
    """A clip, and the command that imports what is there for it."""

    clip: Path
    command: Command | None
    """None unless one file or folder is named like the clip."""
    source: Path
    target: Path
    """The file or folder that it makes; a clip that has it is done."""
    overwrite: bool
    several: bool
    """True if several are."""


@dataclass(frozen=True)
class Imported:
    """The outcome of a clip that did not fail."""

    clip: str
    kept: bool
    warnings: tuple[str, ...] = ()


def import_many(
    source: Path, clips: Path, target: str, overwrite: bool, command: Callable[[Path, Path], Command], debug: bool
) -> int:
    """Import into every clip below a folder; return 1 if one failed, 3 with warnings, else 0.

    ``command`` makes the command of a clip from what ``source`` has under its name (a folder, or one file) and the
    clip. Clips that have ``target`` are done. A clip that fails does not end the others.
    """
    if not source.is_dir():
        raise InputError(source, "", "no such folder", "a folder with something named like each clip")
    by_stem: dict[str, list[Path]] = {}
    for one in sorted([*files.list_files(source), *files.folders_in(source)]):
        by_stem.setdefault(one.name if one.is_dir() else one.stem, []).append(one)

    def job(name: str, folder: Path) -> ImportJob:
        found = by_stem.get(name) or by_stem.get(folder.name) or []
        made = command(found[0], folder) if len(found) == 1 else None
        place = source / (" and ".join(one.name for one in found) or name)
        return ImportJob(folder, made, place, folder / target, overwrite, len(found) > 1)

    imported, failed = for_each_clip([clips], job, import_one, 1, debug)
    for each in imported:
        for text in each.warnings:
            print_note(f"{each.clip}: warning: {text}")
    kept = sum(one.kept for one in imported)
    print_result(f"{format_count(len(imported) - kept, 'clip')} imported, {kept} done already, {failed} failed")
    return 1 if failed else 3 if any(one.warnings for one in imported) else 0


def import_one(job: ImportJob, progress: Callable[[str, float], None] = lambda *_: None) -> Imported | Outcome:
    """Import into one clip. Raises nothing: a failure is returned."""
    from getagrip.batch.job import failed_outcome

    if job.target.exists() and not job.overwrite:
        return Imported(job.clip.name, kept=True)
    try:
        if job.command is None:
            got = "several" if job.several else "no such file or folder"
            raise InputError(job.source, "", got, "one file or folder named like the clip")
        with redirect_stdout(NullOutput()), redirect_stderr(NullOutput()), collect_warnings() as warnings:
            job.command.run()
    except Exception as error:  # one clip's trouble must not end the others
        return failed_outcome(job.clip.name, error)
    return Imported(job.clip.name, kept=False, warnings=tuple(warnings))
