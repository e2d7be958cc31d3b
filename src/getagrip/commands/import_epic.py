"""``getagrip import epic`` and ``getagrip epic candidates``: EPIC-Grasps as clips, and where more may be found."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from getagrip.batch.clips import FEW
from getagrip.batch.job import Outcome, failure
from getagrip.batch.pool import DIED, cores, in_processes
from getagrip.clip import write_clip
from getagrip.datasets.epic import candidates as epic_candidates
from getagrip.datasets.epic import clips as epic
from getagrip.datasets.epic import files as epic_files
from getagrip.datasets.epic import visor
from getagrip.datasets.epic.images import Frames, Images, Video
from getagrip.errors import InputError, UsageError
from getagrip.fitting import pose_priors as priors
from getagrip.io import files
from getagrip.io.terminal import progress_bar

COLUMNS = ("vid", "st_bound", "ed_bound", "contact", "handside", "cat", "hos_name", "mp4_name")
"""Of the table of candidates: EPIC-Grasps' own, those that an annotator has still to fill left out."""
UNMAPPED = f"no {visor.MAPPING} beside VISOR's files: its frame numbers are taken for EPIC's, a few frames off"


@dataclass(frozen=True)
class Sources:
    """Where everything is that clips are made of. Raises ``UsageError`` for options that do not go together."""

    visor: Path
    frames: Path | None = None
    videos: Path | None = None
    hands: Path | None = None
    cad: Path | None = None
    cameras: Path | None = None
    focal: float | None = None

    def __post_init__(self) -> None:
        if (self.frames is None) == (self.videos is None):
            raise UsageError("--frames or --videos: name one of them, the folder of EPIC-KITCHENS' images or videos")
        if self.cameras is not None and self.focal is not None:
            raise UsageError("--cameras and --focal: name one of them")
        if self.focal is not None and not 0.05 * epic.SIZE[0] <= self.focal <= 100 * epic.SIZE[0]:
            raise UsageError(f"--focal: got {self.focal:g}, expected pixels of images {epic.SIZE[0]} wide")


@dataclass(frozen=True)
class Job:
    """The grasps of one video."""

    video: str
    grasps: tuple[epic_files.Grasp, ...]
    annotations: tuple[Path, ...]
    mapping: Path | None
    sources: Sources
    out: Path


@dataclass(frozen=True)
class Imported:
    """What became of the grasps of a video."""

    clips: Sequence[Outcome] = ()
    notes: Sequence[str] = ()
    """What was left out, in words."""
    handless: int = 0
    """Clips that lack their hands."""
    guessed: int = 0
    """Clips made now whose camera is a guess."""


def import_epic(table: Path, errata: Path | None, sources: Sources, starts: Path | None, out: Path, debug: bool) -> int:
    """Write EPIC-Grasps' clips as ``out/<name>/``, videos shared out over processes; 1 if a grasp failed, else 0.

    Clips that are there are kept; those that lack their hands are made again once there is a hand file for them.
    ``starts`` is a folder of poses for ``reconstruct --init priors``, which is only looked at. Raises ``InputError``
    for tables that are malformed, and where VISOR is not.
    """
    grasps = epic_files.read_grasps(table, errata or epic_files.errata_beside(table))
    _tell_starts(starts, grasps, sources.cad)
    there = visor.find(sources.visor)
    by_video: dict[str, list[epic_files.Grasp]] = {}
    for grasp in grasps:
        by_video.setdefault(grasp.video, []).append(grasp)
    absent = {video: wanted for video, wanted in by_video.items() if video not in there}
    if absent:
        count = sum(map(len, absent.values()))
        print(f"{count} grasps left out: VISOR's files of {len(absent)} videos are not there", file=sys.stderr)
    mapping = visor.find_mapping(sources.visor)
    if mapping is None:
        print(UNMAPPED, file=sys.stderr)
    jobs = [Job(v, tuple(g), tuple(there[v]), mapping, sources, out) for v, g in by_video.items() if v in there]
    counts, handless, guessed = Counter[str](), 0, 0
    with progress_bar() as bar:
        task = bar.add_task("videos", total=len(jobs))
        for job, imported in _done(jobs):
            for outcome in imported.clips:
                counts[outcome.state] += 1
                if outcome.state == "failed":
                    print(f"failed: {outcome.message}", outcome.trace if debug else "", file=sys.stderr)
                else:
                    print(outcome.message)
            for note in imported.notes:
                print(f"{job.video}: {note}", file=sys.stderr)
            handless += imported.handless
            guessed += imported.guessed
            bar.advance(task)
    print(f"{counts['done']} clips, {counts['kept']} already there, {counts['failed']} failed")
    if guessed:
        print(f"the camera of {guessed} clips is {epic.pinhole().source}; name --cameras or --focal", file=sys.stderr)
    if handless:
        print(
            f"{handless} clips lack their hand.npz: docs/estimators.md tells how to make it from a clip's frames; "
            "add it to the clip, or call this again with --hands",
            file=sys.stderr,
        )
    return 1 if counts["failed"] else 0


def _done(jobs: Sequence[Job]) -> Iterator[tuple[Job, Imported]]:
    """What becomes of each job, as they finish."""
    if len(jobs) <= FEW:
        yield from ((job, import_video(job)) for job in jobs)
        return
    for job, imported in in_processes(import_video, jobs, cores()):
        dead = Imported([Outcome(job.video, "failed", f"{job.video}: {DIED}")])
        yield job, imported or dead


def import_video(job: Job) -> Imported:
    """Write the clips of one video. Raises nothing."""
    outcomes, notes, handless, guessed = list[Outcome](), list[str](), 0, 0
    try:
        waiting = []
        for grasp in job.grasps:
            folder = job.out / grasp.name
            if folder.exists() and ((folder / "hand.npz").exists() or _hand_file(job, grasp) is None):
                outcomes.append(Outcome(grasp.name, "kept", f"{folder}: already there"))
                handless += not (folder / "hand.npz").exists()
            else:
                waiting.append(grasp)
        if not waiting:
            return Imported(outcomes, notes, handless)
        camera, images_of = _camera(job), _images(job)
        seen = epic.annotated(job.annotations, visor.read_mapping(job.mapping, job.video), waiting)
        for grasp in waiting:
            try:
                hands = _hand_file(job, grasp)
                mesh = epic.category_mesh(grasp.category, job.sources.cad)
                made = epic.clip(grasp, seen.pop(grasp.name), *mesh, camera, hands, job.mapping is not None)
                if isinstance(made, str):
                    notes.append(f"{grasp.name}: left out: {made}")
                    continue
                clip, masks = made
                images = images_of([int(name) for name in clip.frames])
                folder = job.out / grasp.name
                write_clip(clip, masks, folder, images, replace=True)
                outcomes.append(Outcome(grasp.name, "done", str(folder)))
                handless += hands is None
                guessed += camera.is_guess and (hands is None or hands.K is None)
            except Exception as error:  # one grasp's trouble must not end the others
                outcomes.append(failure(grasp.name, error))
    except Exception as error:
        outcomes.append(failure(job.video, error))
    return Imported(outcomes, notes, handless, guessed)


def _hand_file(job: Job, grasp: epic_files.Grasp) -> epic.HandFile | None:
    """The hand file of a grasp, where there is one."""
    if job.sources.hands is None or not (path := job.sources.hands / f"{grasp.name}.npz").is_file():
        return None
    return epic.hand_file(path)


def _images(job: Job) -> Images:
    """The images of a video."""
    if job.sources.frames is not None:
        return Frames(job.sources.frames, job.video)
    if job.sources.videos is not None:
        return Video(job.sources.videos, job.video)
    raise UsageError("--frames or --videos: name one of them")


def _camera(job: Job) -> epic.Camera:
    """The camera of a video."""
    if job.sources.cameras is None:
        return epic.pinhole(job.sources.focal)
    return epic.read_camera(job.sources.cameras / f"{job.video}.json")


def _tell_starts(folder: Path | None, grasps: Sequence[epic_files.Grasp], cad: Path | None) -> None:
    """Say how the poses that are brought along will be used, and whether they can be. Raises ``InputError``."""
    if folder is None:
        return
    learnt = priors.read_folder(folder)
    kinds = sorted({(grasp.category, grasp.side) for grasp in grasps})
    without = [f"{category} in a {side} hand" for category, side in kinds if not len(learnt.of(category, side))]
    print(f"to start from the poses of {folder}: getagrip reconstruct ... --init priors --priors {folder}")
    if without:
        print(f"{folder} has no poses of {', '.join(without)}", file=sys.stderr)
    if cad is None:
        print("poses belong to the meshes they were made with: bring these with --cad", file=sys.stderr)


def find_candidates(
    annotations: Path, labels: Sequence[Path], categories: Sequence[str], out: Path, json: Path | None, debug: bool
) -> int:
    """Write where stable grasps may be as a table, and as JSON; 1 if a video could not be read, else 0.

    Raises ``UsageError`` without labels, ``InputError`` for labels that are malformed and where VISOR is not.
    """
    if not labels:
        raise UsageError("--actions: name EPIC_100_train.csv or EPIC_100_validation.csv, or both")
    actions = epic_files.read_actions(labels)
    found, failed, unlabelled = list[epic_candidates.Candidate](), 0, 0
    there, mapping = visor.find(annotations), visor.find_mapping(annotations)
    if mapping is None:
        print(UNMAPPED, file=sys.stderr)
    with progress_bar() as bar:
        task = bar.add_task("videos", total=len(there))
        for video, paths in there.items():
            try:
                sparse = [path for path in paths if not visor.is_dense(path)]  # contacts are marked there
                frames = (frame for path in sparse for frame in visor.read_frames(path))
                touching = epic_candidates.contacts(frames, visor.read_mapping(mapping, video))
                found += epic_candidates.candidates(video, touching, actions.get(video, []))
                unlabelled += video not in actions
            except InputError as error:
                outcome = failure(video, error)
                print(f"failed: {outcome.message}", outcome.trace if debug else "", file=sys.stderr)
                failed += 1
            bar.advance(task)
    chosen = [candidate for candidate in found if not categories or candidate.category in categories]
    _write_table(out, chosen)
    if json is not None:
        rows = [asdict(candidate) | {"seconds": candidate.seconds, "name": candidate.name} for candidate in chosen]
        files.write_json(json, rows)
    for category, count in sorted(Counter(candidate.category for candidate in chosen).items()):
        print(f"{category}: {count}")
    if unlabelled:
        print(f"{unlabelled} of {len(there)} videos have no labelled actions: left out", file=sys.stderr)
    print(f"{out}: {len(chosen)} candidates from {len(there) - failed} videos")
    return 1 if failed else 0


def _write_table(path: Path, found: Sequence[epic_candidates.Candidate]) -> None:
    """Write candidates as a table with ``COLUMNS``, as EPIC-Grasps has them: -1 for more than one contact."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for one in found:
            contact = one.contacts[0] if len(one.contacts) == 1 else -1
            bounds = one.start_bound, one.end_bound
            hand = f"{one.side} hand"
            table.writerow([one.video, *bounds, contact, hand, one.category, one.entity, f"{one.name}.mp4"])
