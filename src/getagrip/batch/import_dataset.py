"""``getagrip import``: write the clips of a dataset, its parts shared over processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Set
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.engine import Engine
from getagrip.batch.job import Outcome, failed_outcome, lost_outcome
from getagrip.batch.ledger import Ledger, LedgerEntry, State, ledger_folder
from getagrip.batch.scheduling import DEFAULT_SCHEDULING, SchedulingOptions
from getagrip.checks.intrinsics import camera_warning
from getagrip.clip import Clip, write_clip
from getagrip.clip.read import read_header
from getagrip.errors import InputError, UsageError
from getagrip.io import files, plugins
from getagrip.io.terminal import format_count, print_note
from getagrip.readers.datasets.dataset import Dataset, Draft, Part
from getagrip.stable_grasps import grasp_lists

CAMERA_WARNING_STATUS = 3
"""Exit status where a clip was written but its camera does not seem to match its images."""


@dataclass(frozen=True)
class ImportJob:
    """A part of a dataset whose clips are to be written."""

    part: Part
    out: Path
    """Parent of the clips' folders."""
    only: Set[str] | None = None
    """Names of the clips to write; None: all."""

    @property
    def name(self) -> str:
        """Name of the part."""
        return self.part.name


@dataclass(frozen=True)
class ImportedPart:
    """The outcome of a part."""

    clips: Sequence[Outcome]
    notes: Sequence[str] = ()
    """Notes on skipped data."""
    made: Sequence[Mapping[str, object]] = ()
    """Provenance of the new clips."""
    handless: int = 0
    """Number of clips without hands, new or kept."""
    warned: int = 0
    """Number of new clips whose camera does not seem to match their images."""


def import_clips(
    dataset: Dataset,
    out: Path,
    debug: bool,
    share: SchedulingOptions = DEFAULT_SCHEDULING,
    only: Set[str] | None = None,
) -> int:
    """Write the clips of a dataset, or ``only`` the named ones, as ``out/<clip name>/``.

    Returns 1 if a part failed, 3 if a camera does not seem to match its images, else 0. Existing clips are kept, unless
    they lack hands that are known now. Unfinished files of killed processes are removed. Clips cut to grasps get a list
    of grasps (``write_list``). Calls may share a folder: its ledger assigns the parts. Raises the errors of
    ``Dataset.parts``, ``UsageError`` where the folder's clips were cut differently, and ``GetagripError`` where the
    ledger cannot be written.
    """
    parts = [part for part in dataset.parts(print_note) if only is None or dataset.may_make(part, only)]
    jobs = [ImportJob(part, out, only) for part in parts if part.name in share.shard]
    cut = dataset.cut_record()
    claim_folder(out, cut)
    files.remove_stale_folders(out)
    counts, made, handless, warned = Counter[str](), list[Mapping[str, object]](), 0, 0
    engine = Engine(work=import_part, lost=_lost_import, entry=_import_entry, options=repr(dataset))
    with (
        Ledger(ledger_folder(out, share.ledger)) as ledger,
        closing(share.ended(engine, jobs, len(jobs), ledger, dataset.parts_are)) as ended,
    ):
        for imported in ended:
            for outcome in imported.clips:
                if outcome.state == "failed":
                    print_outcome(outcome, debug)
                else:
                    print(outcome.message)
            for note in imported.notes:
                print_note(note)
            counts.update(outcome.state for outcome in imported.clips if outcome.state != "failed")
            counts["failed"] += any(outcome.state == "failed" for outcome in imported.clips)
            made += imported.made
            handless += imported.handless
            warned += imported.warned
            if share.fail_fast and counts["failed"]:
                print_note(f"--fail-fast: no other of the {dataset.parts_are} is begun")
                break
    if cut is not None:
        print(f"{out / grasp_lists.GRASP_LIST_FILE}: {format_count(write_list(out, cut, print_note), 'grasp')}")
    failed = f"{counts['failed']} of {len(jobs)} {dataset.parts_are} failed"
    print(f"{format_count(counts['done'], 'clip')}, {counts['kept']} already there, {failed}")
    for advice in dataset.advice(made, handless):
        print_note(advice)
    return 1 if counts["failed"] else CAMERA_WARNING_STATUS if warned else 0


def _lost_import(job: ImportJob, why: str) -> ImportedPart:
    return ImportedPart([lost_outcome(job, why)])


def _import_entry(imported: ImportedPart) -> LedgerEntry:
    states = Counter(outcome.state for outcome in imported.clips)
    why = "; ".join(outcome.message for outcome in imported.clips if outcome.state == "failed")
    state: State = "failed" if states["failed"] else "done" if states["done"] else "kept"
    return LedgerEntry("", state, why, about={str(kind): count for kind, count in states.items()})


def import_part(job: ImportJob) -> ImportedPart:
    """Write the clips of one part. Raises nothing."""
    outcomes, notes, made, warned = list[Outcome](), list[str](), list[Mapping[str, object]](), 0

    def missing(name: str, with_hands: bool = False) -> bool:
        folder = job.out / name
        if job.only is not None and name not in job.only:
            return False
        if folder.exists() and ((folder / "hand.npz").exists() or not with_hands):
            outcomes.append(Outcome(name, "kept", f"{folder}: already there"))
            return False
        return True

    try:
        for draft in job.part.drafts(missing, notes.append):
            try:
                clip = _write_draft(draft, job.out / draft.name)
                if clip is not None:
                    outcomes.append(Outcome(draft.name, "done", str(job.out / draft.name)))
                    made.append(clip.provenance)
                    if why := camera_warning(clip.K, clip.size):
                        warned += 1
                        notes.append(f"{job.out / draft.name}: warning: camera: {why}")
            except Exception as error:  # an error in one clip must not end the others
                outcomes.append(failed_outcome(draft.name, error))
    except Exception as error:  # nor an error in one part
        outcomes.append(failed_outcome(job.part.name, error))
    clips = [job.out / outcome.name for outcome in outcomes if outcome.state != "failed"]
    handless = sum(not (folder / "hand.npz").exists() for folder in clips)
    return ImportedPart(outcomes, notes, made, handless, warned)


def _write_draft(draft: Draft, folder: Path) -> Clip | None:
    """Write a clip and return it; None where no frame is left. Raises the errors of ``Draft.make``."""
    with plugins.convert_base_exceptions():
        made = draft.make()
    if made is None:
        return None
    clip, masks = made
    images = None if draft.images is None else draft.images(clip)
    hand = None if draft.hand is None else draft.hand(clip)
    write_clip(clip, masks, folder, images, (folder / "clip.json").is_file(), hand)
    return clip


def claim_folder(out: Path, cut: Mapping[str, object] | None) -> None:
    """Note in the folder how its clips will be cut (None: not cut).

    Raises ``UsageError`` where it holds clips that were cut differently, ``InputError`` for a damaged list.
    """
    path = out / grasp_lists.GRASP_LIST_FILE
    if path.exists():
        if cut is None or grasp_lists.read_cut(path) != cut:
            here = "no grasps" if cut is None else files.shorten_value(dict(cut))
            why = f"it holds clips cut as its {path.name} states, not {here}"
            raise UsageError(f"--out {out} cannot be used with this import: {why}")
    elif cut is not None:
        if next(out.glob("*/clip.json"), None) is not None:
            why = f"it holds clips without a {path.name} that states how they were cut"
            raise UsageError(f"--out {out} cannot be used with this import: {why}")
        out.mkdir(parents=True, exist_ok=True)
        grasp_lists.write_listed_grasps(path, [], cut)


def write_list(out: Path, cut: Mapping[str, object], note: Callable[[str], None]) -> int:
    """Write the list of a folder's grasps, from its clips alone; returns the number of grasps."""
    grasps = []
    for folder in sorted(path.parent for path in out.glob("*/clip.json")):
        try:
            path = folder / "clip.json"
            row = read_header(folder).fields["provenance"].get("grasp")
            if not isinstance(row, dict):
                raise InputError(path, "provenance.grasp", files.shorten_value(row), "the grasp that the clip is")
            grasps.append(grasp_lists.parse_grasp_row(path, "provenance.grasp.", row))
        except InputError as error:
            note(f"not in {grasp_lists.GRASP_LIST_FILE}: {error}")
    grasp_lists.write_listed_grasps(out / grasp_lists.GRASP_LIST_FILE, grasps, cut)
    return len(grasps)
