"""``getagrip import``: clips from other people's layouts."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.clip import write_clip
from getagrip.datasets import dexycb, dexycb_files
from getagrip.errors import UsageError
from getagrip.run.batch import FEW, progress_bar
from getagrip.run.job import Outcome, failure
from getagrip.run.pool import cores, in_processes


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
    done = ((job, _import_sequence(job)) for job in jobs)
    results = done if len(jobs) <= FEW else in_processes(_import_sequence, jobs, cores())
    counts = {"done": 0, "kept": 0, "failed": 0}
    with progress_bar() as bar:
        task = bar.add_task("sequences", total=len(jobs))
        for job, imported in results:
            dead = Outcome(job.sequence.name, "failed", "its process died twice; out of memory?")
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
