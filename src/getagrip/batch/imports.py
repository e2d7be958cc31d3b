"""``getagrip import``: clips from other people's layouts."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from getagrip.batch.clips import FEW
from getagrip.batch.job import Outcome, failure
from getagrip.batch.pool import DIED, cores, in_processes
from getagrip.clip import write_clip
from getagrip.datasets import arctic, ho3d, hoi4d, tracks
from getagrip.datasets.dexycb import clips as dexycb
from getagrip.datasets.dexycb import files as dexycb_files
from getagrip.errors import InputError, UsageError
from getagrip.io.terminal import progress_bar

TAKES = {
    "hot3d": ("whole", "timelines", "first_frame"),
    "dexycb": ("meshes", "whole"),
    "arctic": ("mano", "view", "whole"),
    "hoi4d": ("mano", "whole"),
    "ho3d": ("meshes", "mano", "whole"),
}
"""The options of each source."""


Cut = Callable[[Iterable[tracks.Track], tracks.Note], Iterator[tracks.Piece]]
"""How tracks become the pieces that clips are made of."""


@dataclass(frozen=True)
class Given:
    """Options of the command, of which each source takes some (``TAKES``)."""

    meshes: Path | None
    mano: Path | None
    view: int | None
    whole: bool
    timelines: Path | None = None
    first_frame: int | None = None


def import_clips(source: str, root: Path, out: Path, given: Given, debug: bool) -> int:
    """Write clips of a dataset as ``out/<clip name>/``, what is there already kept; 1 if some failed, else 0.

    Raises ``UsageError`` for options that the source does not take, and as its reader does.
    """
    for option, value in vars(given).items():
        if option not in TAKES[source] and value not in (None, False):
            taken = ", ".join(f"--{name.replace('_', '-')}" for name in TAKES[source])
            raise UsageError(f"--{option.replace('_', '-')}: got {value}, expected none: {source} takes {taken}")
    if source == "hot3d":
        found, cut, shortest = _of_hot3d(root, given)
        return import_tracks(found, cut, shortest, out, debug)
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
    cut = partial(tracks.pieces, definition=definition, whole=given.whole)
    return import_tracks(found, cut, definition.shortest, out, debug)


def _of_hot3d(root: Path, given: Given) -> tuple[list[tracks.Source], Cut, int]:
    """The recordings of HOT3D, how they are cut, and the fewest frames of a clip."""
    from getagrip.datasets.hot3d import clips as hot3d
    from getagrip.datasets.hot3d import timelines as hot3d_timelines

    if given.timelines is None:
        if given.first_frame is not None:
            raise UsageError(f"--first-frame: got {given.first_frame}, expected none without --timelines")
        return hot3d.sources(root), hot3d.whole if given.whole else hot3d.holds, hot3d.SHORTEST
    if given.whole:
        raise UsageError("--timelines and --whole: name one of them")
    listed = hot3d_timelines.read(given.timelines, _say)
    frames = dict.fromkeys(listed.frames) if given.first_frame is not None else listed.frames
    found = hot3d.sources(root, frames)
    if not found:
        raise InputError(root, "", f"none of the {len(frames)} recordings of {listed.file}", "one of them at least")
    if len(found) < len(frames):
        _say(f"{len(frames) - len(found)} of {len(frames)} recordings of {listed.file} are not there: left out")
    return found, partial(listed.cut, first_frame=given.first_frame or 0), hot3d_timelines.FEWEST


def _say(words: str) -> None:
    print(words, file=sys.stderr)


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
    cut: Cut
    shortest: int
    """The fewest frames of a clip."""
    out: Path

    @property
    def name(self) -> str:
        return self.source.name


def import_tracks(sources: Sequence[tracks.Source], cut: Cut, shortest: int, out: Path, debug: bool) -> int:
    """Write the pieces of sequences as ``out/<clip name>/``, as ``import_dexycb`` does."""
    return _share_out([TracksJob(source, cut, shortest, out) for source in sources], _import_source, debug)


J = TypeVar("J", DexYcbJob, TracksJob)


def _share_out(jobs: Sequence[J], work: Callable[[J], Imported], debug: bool) -> int:
    """Import sequences in processes, and tell what became of each. Returns 1 if one failed, else 0."""
    done = ((job, work(job)) for job in jobs)
    results = done if len(jobs) <= FEW else in_processes(work, jobs, cores())
    counts = {"done": 0, "kept": 0, "failed": 0}
    with progress_bar() as bar:
        task = bar.add_task("sequences", total=len(jobs))
        for job, imported in results:
            dead = Outcome(job.name, "failed", DIED)
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
        for piece in job.cut(job.source.read(notes.append), notes.append):
            folder = job.out / piece.name
            if folder.exists():
                outcomes.append(Outcome(piece.name, "kept", f"{folder}: already there"))
            elif (made := tracks.clip(piece, job.shortest, notes.append)) is not None:
                outcomes.append(Outcome(piece.name, "done", str(write_clip(*made, folder))))
    except Exception as error:
        outcomes.append(failure(job.name, error))
    return Imported(outcomes, notes)
