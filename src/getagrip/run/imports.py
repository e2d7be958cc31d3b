"""``getagrip import``: clips from other people's layouts."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from getagrip.clip import write_clip
from getagrip.datasets import arctic, dexycb, dexycb_files, ho3d, hoi4d, tracks
from getagrip.errors import UsageError
from getagrip.grasps import Definition
from getagrip.run.batch import FEW, progress_bar
from getagrip.run.job import Outcome, failure
from getagrip.run.pool import cores, in_processes

TAKES = {
    "hot3d": (),
    "dexycb": ("meshes", "whole"),
    "arctic": ("mano", "view", "whole"),
    "hoi4d": ("mano", "whole"),
    "ho3d": ("meshes", "mano", "whole"),
}
"""The options of each source."""


@dataclass(frozen=True)
class Given:
    """Options of the command, of which each source takes some (``TAKES``)."""

    meshes: Path | None
    mano: Path | None
    view: int | None
    whole: bool


def import_clips(source: str, root: Path, out: Path, given: Given, debug: bool) -> int:
    """Write clips of a dataset as ``out/<clip name>/``, what is there already kept; 1 if some failed, else 0.

    Raises ``UsageError`` for options that the source does not take, and as its reader does.
    """
    for option, value in vars(given).items():
        if option not in TAKES[source] and value not in (None, False):
            taken = ", ".join(f"--{name}" for name in TAKES[source]) or "none"
            raise UsageError(f"--{option}: got {value}, expected none: {source} takes {taken}")
    if source == "hot3d":
        return import_hot3d(root, out)
    if source == "dexycb" and not given.whole:
        return import_dexycb(root, given.meshes, out, debug)
    if source == "dexycb":
        found, definition = dexycb.sources(root, given.meshes), dexycb.DEFINITION
    elif source == "arctic":
        found, definition = arctic.find(root, given.mano, given.view or 0), arctic.DEFINITION
    elif source == "hoi4d":
        found, definition = hoi4d.find(root, given.mano), hoi4d.DEFINITION
    else:
        found, definition = ho3d.find(root, given.meshes, given.mano), ho3d.DEFINITION
    return import_tracks(found, definition, out, given.whole, debug)


def import_hot3d(root: Path, out: Path) -> int:
    """Write the holds of HOT3D recordings as ``out/<clip name>/``; 1 if a clip is there already, else 0.

    Raises ``InputError`` for files that are missing or malformed, when all else is done.
    """
    from getagrip.datasets import hot3d

    say: Callable[[str], None] = lambda words: print(words, file=sys.stderr)  # noqa: E731
    failures = 0
    with progress_bar() as bar:
        task = bar.add_task(f"clips of {root}", total=None)
        for clip, masks in hot3d.read(root, note=say):
            try:
                print(write_clip(clip, masks, out / clip.name))
            except UsageError as error:
                say(f"failed: {error}")
                failures += 1
            bar.advance(task)
    return 1 if failures else 0


@dataclass(frozen=True)
class DexYcbJob:
    """A sequence of DexYCB to make clips of."""

    sequence: dexycb_files.Sequence
    meshes: Path
    out: Path

    @property
    def name(self) -> str:
        return self.sequence.name


@dataclass(frozen=True)
class Imported:
    """What became of a sequence."""

    clips: Sequence[Outcome] = ()
    notes: Sequence[str] = ()
    """What was left out, in words."""


def import_dexycb(root: Path, meshes: Path | None, out: Path, debug: bool) -> int:
    """Write the visible stable grasps of DexYCB as ``out/<clip name>/``, sequences shared out over processes.

    Clips that are there already are kept. Returns 1 if a sequence failed, else 0. Raises as ``dexycb.clips`` does for
    the whole of it.
    """
    folder = dexycb.mesh_folder(root, meshes)
    jobs = [DexYcbJob(sequence, folder, out) for sequence in dexycb_files.find(root)]
    return _share_out(jobs, _import_sequence, debug)


@dataclass(frozen=True)
class TracksJob:
    """A sequence to make clips of."""

    source: tracks.Source
    definition: Definition
    out: Path
    whole: bool

    @property
    def name(self) -> str:
        return self.source.name


def import_tracks(sources: Sequence[tracks.Source], definition: Definition, out: Path, whole: bool, debug: bool) -> int:
    """Write the stable grasps of sequences as ``out/<clip name>/``, or all frames (``whole``), as ``import_dexycb``."""
    jobs = [TracksJob(source, definition, out, whole) for source in sources]
    return _share_out(jobs, _import_source, debug)


J = TypeVar("J", DexYcbJob, TracksJob)


def _share_out(jobs: Sequence[J], work: Callable[[J], Imported], debug: bool) -> int:
    """Import sequences in processes, and tell what became of each. Returns 1 if one failed, else 0."""
    done = ((job, work(job)) for job in jobs)
    results = done if len(jobs) <= FEW else in_processes(work, jobs, cores())
    counts = {"done": 0, "kept": 0, "failed": 0}
    with progress_bar() as bar:
        task = bar.add_task("sequences", total=len(jobs))
        for job, imported in results:
            dead = Outcome(job.name, "failed", "its process died twice; out of memory?")
            for outcome in [dead] if imported is None else imported.clips:
                counts[outcome.state] += 1
                if outcome.state == "failed":
                    print(f"failed: {outcome.message}", outcome.trace if debug else "", file=sys.stderr)
                else:
                    print(outcome.message)
            for note in imported.notes if imported else ():
                print(note, file=sys.stderr)
            bar.advance(task)
    print(f"{counts['done']} clips, {counts['kept']} already there, {counts['failed']} sequences failed")
    return 1 if counts["failed"] else 0


def _import_sequence(job: DexYcbJob) -> Imported:
    """Write the clips of one sequence."""
    outcomes: list[Outcome] = []
    notes: list[str] = []
    try:
        for grasp in dexycb.grasps(job.sequence, job.meshes, notes.append):
            folder = job.out / grasp.name
            if folder.exists():
                outcomes.append(Outcome(grasp.name, "kept", f"{folder}: already there"))
            elif (made := dexycb.clip(grasp, job.meshes, notes.append)) is not None:
                outcomes.append(Outcome(grasp.name, "done", str(write_clip(*made, folder))))
    except Exception as error:
        outcomes.append(failure(job.sequence.name, error))
    return Imported(outcomes, notes)


def _import_source(job: TracksJob) -> Imported:
    """Write the clips of one sequence."""
    outcomes: list[Outcome] = []
    notes: list[str] = []
    try:
        for piece in tracks.pieces(job.source.read(notes.append), job.definition, job.whole, notes.append):
            folder = job.out / piece.name
            if folder.exists():
                outcomes.append(Outcome(piece.name, "kept", f"{folder}: already there"))
            elif (made := tracks.clip(piece, job.definition.shortest, notes.append)) is not None:
                outcomes.append(Outcome(piece.name, "done", str(write_clip(*made, folder))))
    except Exception as error:
        outcomes.append(failure(job.name, error))
    return Imported(outcomes, notes)
