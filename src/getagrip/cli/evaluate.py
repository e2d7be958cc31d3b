"""``getagrip evaluate``: metrics of results, and of another system's poses or meshes (``--poses``, ``--meshes``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, TypeVar

from tyro.conf import arg

from getagrip.cli.command import ClipsFolder, Command, FirstNumber, Results, failed_path_outcome
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.options import Flag, OptionalFile, OptionalFolder, one_of
from getagrip.io.terminal import console, print_note, progress_bar

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.clip import Clip
    from getagrip.metrics.evaluate.external import MeshFrame
    from getagrip.metrics.evaluate.results import Evaluation

Evaluated: TypeAlias = "tuple[Evaluation | None, list[Outcome]]"
"""The evaluation, and failures to read files."""


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Print the metrics of results, and of another system's poses or meshes beside them."""

    results: Results = ()
    """Result folders, or folders of results."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    poses: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Another system's poses of the clip's mesh: one 4x4 for each frame (.npz, .npy, .json, .txt, or a file for each
    frame in a folder), or BOP's results (.csv). For many clips: a folder of such files or folders, named like the
    clips. They are of the clips that the results are of; without results it needs --clips. The rows appear under the
    name of PATH."""
    meshes: OptionalFolder = None
    """Another system's meshes, one for each frame, in metres: DIR/<clip>/<frame>.obj (.ply, .stl, .glb). Needs
    --mesh-frame, and without results --clips. The rows appear under the name of DIR."""
    mesh_frame: Annotated[Literal["camera", "hand"] | None, one_of("camera", "hand"), arg(help_behavior_hint="")] = None
    """The frame that the vertices of --meshes are in: the clip's camera frame, or its hand frame."""
    first: FirstNumber = None
    """The number that these files give to the clip's first frame, if they count from another start."""
    contact: Flag = False
    """Also print stable contact by nine definitions: within 0, 5 and 10 mm, each for the object's vertices, the hand's
    vertices, and points of the object's surface."""
    json: OptionalFile = None
    """Write every number here, unrounded."""

    def check(self) -> None:
        super().check()
        if not self.results and self.meshes is None and self.poses is None:
            raise UsageError("missing RESULT: name at least one result, or --poses, or --meshes")
        other = "--poses" if self.poses is not None else "--meshes"
        if (self.poses is not None or self.meshes is not None) and self.clips is None and not self.results:
            needed = "the clip, or the folder that holds the clips, or a result of the clip"
            raise UsageError(f"missing --clips: {other} needs {needed}")
        if self.meshes is not None and self.mesh_frame is None:
            raise UsageError("missing --mesh-frame: --meshes needs the frame of their vertices, camera or hand")
        if self.meshes is None and self.mesh_frame is not None:
            raise UsageError("missing --meshes: --mesh-frame is the frame of their vertices")

    def run(self) -> int:
        """Print the metrics of results, and write them to a file; return 1 if any evaluation failed, else 0.

        Another system's meshes and poses are evaluated in the frames of our results of the same clip, by default in all
        frames of the clip. Raises ``InputError`` for a path without meshes or poses.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.executor import PROCESS_DIED_TWICE, for_each_job
        from getagrip.batch.job import Outcome, failed_outcome
        from getagrip.metrics.evaluate import contact_tables, results_table, summary

        jobs, problems = list[ResultJob](), list[Outcome]()
        for path in self.results:
            try:
                jobs += [ResultJob(folder, self.clips) for folder in list_result_folders(path)]
            except (InputError, OSError) as error:
                problems.append(failed_outcome("", error))
        evaluations: list[Evaluation] = []
        folders = self._folders_of_clips(jobs)

        def died(job: J) -> Evaluated:
            return None, [Outcome(str(job.folder), "failed", PROCESS_DIED_TWICE)]

        with progress_bar() as bar:

            def evaluate_all(title: str, work: Callable[[J], Evaluated], jobs: Sequence[J]) -> None:
                task = bar.add_task(title, total=len(jobs), visible=bool(jobs))
                for made, failed in for_each_job(work, jobs, died, lambda _: bar.advance(task)):
                    evaluations.extend([] if made is None else [made])
                    problems.extend(failed)

            evaluate_all("results", evaluate_one, jobs)
            frames = {made.clip: tuple(made.frames) for made in evaluations}
            others = [] if self.meshes is None else mesh_jobs(self, frames, folders)
            others += [] if self.poses is None else pose_jobs(self, frames, folders)
            evaluate_all("of other systems", evaluate_other, others)
        for outcome in problems:
            print_outcome(outcome, self.debug)
        if evaluations:
            for table in (results_table(evaluations), *(contact_tables(evaluations) if self.contact else ())):
                console().print(table)
        for made in evaluations:
            _print_warnings(made)
        if self.json is not None:
            files.write_json(self.json, summary(evaluations))
        return 1 if problems else 0

    def _folders_of_clips(self, jobs: list[ResultJob]) -> dict[str, Path]:
        """Find the clips of results, by name, for the evaluation of another system's output."""
        from contextlib import suppress

        from getagrip.metrics.evaluate.results import clip_folder
        from getagrip.result import read_result_record

        folders: dict[str, Path] = {}
        for job in jobs if self.poses is not None or self.meshes is not None else []:
            with suppress(InputError, OSError):  # evaluating the result reports the error
                record = read_result_record(job.folder)
                folders[record["clip"]] = clip_folder(job.folder, record, job.clips)
        return folders


@dataclass(frozen=True)
class ResultJob:
    """A result to evaluate."""

    folder: Path
    clips: Path | None


def _print_warnings(made: Evaluation) -> None:
    """Print the findings of an evaluated result and notes on its metrics."""
    warnings = [*made.findings, *made.notes]
    if missing := int(made.metrics.get("frames_without_mesh", 0)):
        warnings.append(f"no mesh of {missing} of {len(made.frames)} frames: IOU 0, no contact")
    for warning in warnings:
        print_note(f"{made.method}, {made.clip}: {warning}")


def evaluate_one(job: ResultJob) -> Evaluated:
    """Evaluate a result; failures are returned, not raised."""
    from getagrip.metrics.evaluate import evaluate_result

    try:
        return evaluate_result(job.folder, job.clips), []
    except Exception as error:  # one result's failure must not end the others
        return None, [failed_path_outcome(job.folder, error)]


def is_batch_file(path: Path) -> bool:
    """Return whether a path is a file that a batch writes beside results, which the pattern ``results/*`` matches."""
    from getagrip.batch.ledger import LEDGER_FILE as LEDGER
    from getagrip.batch.summary import INDEX_FILE, SUMMARY_FILE

    return path.name in (LEDGER, SUMMARY_FILE, INDEX_FILE) and path.is_file()


def list_result_folders(path: Path) -> list[Path]:
    """List the results in a path: itself, or the folders in it; none for a batch's file.

    Raises ``InputError`` for a folder without results.
    """
    if is_batch_file(path):
        return []
    if (path / "result.json").exists():
        return [path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    results = sorted(found.parent for found in path.glob("*/result.json"))
    if not results:
        raise missing_result_error(path)
    return results


def missing_result_error(path: Path) -> InputError:
    """Make the error for a folder without results."""
    got = "a clip" if (path / "clip.json").exists() else "no result.json in it or in its folders"
    return InputError(path, "", got, "a result that getagrip reconstruct made, or a folder of results")


Frames = Mapping[str, tuple[str, ...]]
"""Frames to evaluate by clip name; all frames of other clips."""
Folders = Mapping[str, Path]
"""Folders of the results' clips by name."""


@dataclass(frozen=True)
class OtherJob:
    """Another system's poses or meshes of one clip."""

    folder: Path
    """The file or folder of poses or meshes."""
    clip: Path
    method: str
    frames: Frames
    first: int | None
    """The number of the first frame's pose or mesh; None for the frames' own numbers."""
    mesh_frame: MeshFrame | None = None
    """Frame of the meshes' vertices; None for poses."""


J = TypeVar("J", ResultJob, OtherJob)


def mesh_jobs(options: Evaluate, frames: Frames, of_results: Folders = MappingProxyType({})) -> list[OtherJob]:
    """Make a job for each clip with meshes: ``<clip>/<frame>.obj``, or ``<frame>.obj`` of one clip.

    Raises ``InputError`` without meshes, ``UsageError`` for meshes of an unknown clip.
    """
    from getagrip.geometry.mesh_files import MESH_SUFFIXES

    root, where = options.meshes, options.clips
    assert root is not None
    if not root.is_dir():
        raise InputError(root, "", "no such folder", "a folder of meshes, <clip>/<frame>.obj")
    folders = [root] if files.list_files(root, MESH_SUFFIXES) else files.folders_in(root)
    if not folders:
        raise InputError(root, "", "no meshes in it or in its folders", "<clip>/<frame>.obj")
    how = root.resolve().name, frames, options.first, options.mesh_frame
    if len(folders) == 1:
        return [OtherJob(folders[0], _find_clip(folders[0], where, of_results), *how)]
    if where is not None and _is_clip(where):
        raise InputError(where, "", "a single clip", f"a folder of clips (there are {len(folders)} mesh folders)")
    return [OtherJob(folder, _find_clip_by_name(folder.name, where, of_results), *how) for folder in folders]


def pose_jobs(options: Evaluate, frames: Frames, of_results: Folders = MappingProxyType({})) -> list[OtherJob]:
    """Make a job for each clip with poses, of one clip or of several by name.

    Raises ``InputError`` without poses, ``UsageError`` for poses of an unknown clip.
    """
    from getagrip.clip.object_poses import POSE_FILE_SUFFIXES, poses_path_of_clip
    from getagrip.clip.read import read_name

    root, where = options.poses, options.clips
    assert root is not None
    method = root.resolve().stem if root.is_file() else root.resolve().name
    how = method, frames, options.first
    if not root.exists():
        raise InputError(root, "", "no such file or folder", "poses of the object")
    if where is not None and _is_clip(where):
        name, one = read_name(where), root
        if root.is_dir() and any((root / f"{name}{suffix}").exists() for suffix in ("", *POSE_FILE_SUFFIXES)):
            one = poses_path_of_clip(root, name)
        return [OtherJob(one, where, *how)]
    if root.is_file():
        return [OtherJob(root, _find_clip(root, where, of_results), *how)]
    places = sorted([*files.folders_in(root), *files.list_files(root, POSE_FILE_SUFFIXES)])
    if not places:
        raise InputError(root, "", "no poses in it", f"<clip>/, or <clip> with one of {', '.join(POSE_FILE_SUFFIXES)}")
    named = [path.name if path.is_dir() else path.stem for path in places]
    clips = [_find_clip_by_name(name, where, of_results) for name in named]
    if len(frames) == 1 and not any(clip.exists() for clip in clips):  # files of single frames
        return [OtherJob(root, _find_clip_by_name(next(iter(frames)), where, of_results), *how)]
    return [OtherJob(path, clip, *how) for path, clip in zip(places, clips, strict=True)]


def _is_clip(folder: Path) -> bool:
    return (folder / "clip.json").is_file()


def _find_clip(place: Path, where: Path | None, of_results: Folders) -> Path:
    """Return the clip of one file or folder: the clip of the same name, else the only clip with results.

    Raises ``UsageError`` without either.
    """
    if where is not None and _is_clip(where):
        return where
    named = _find_clip_by_name(place.stem if place.is_file() else place.name, where, of_results)
    if _is_clip(named):
        return named
    if len(of_results) == 1:
        return next(iter(of_results.values()))
    known = f"; the results are of {', '.join(sorted(of_results))}" if of_results else ""
    raise UsageError(f"which clip is {place} of? Name it: --clips CLIP{known}")


def _find_clip_by_name(name: str, where: Path | None, of_results: Folders) -> Path:
    """Return a clip's folder by name: in ``--clips``, else the clip of a result, or a folder beside that.

    Raises ``UsageError`` if no clip's folder is known.
    """
    if where is not None and (where / name).exists():
        return where / name
    beside = where or next((folder.parent for folder in of_results.values()), None)
    if beside is None:
        raise UsageError("missing --clips: no result says where its clip is")
    return of_results.get(name, beside / name)


def evaluate_other(job: OtherJob) -> Evaluated:
    """Evaluate another system's output for a clip; failures are returned, not raised."""
    from getagrip.clip import read_clip

    try:
        clip = read_clip(job.clip)
        return _evaluate_poses(job, clip) if job.mesh_frame is None else _evaluate_meshes(job, clip, job.mesh_frame)
    except Exception as error:  # one clip's failure must not end the others
        return None, [failed_path_outcome(job.folder, error)]


def _evaluate_poses(job: OtherJob, clip: Clip) -> Evaluated:
    from getagrip.clip import find_masks
    from getagrip.metrics.evaluate import evaluate
    from getagrip.metrics.evaluate.external import read_external_poses

    masks = find_masks(clip)
    result = read_external_poses(job.folder, job.method, clip, masks, job.first)
    if clip.name in job.frames:
        index = clip.index_of(job.frames[clip.name])
        result, clip, masks = result.take(index), clip.take(index), masks and masks.take(index)
    made = evaluate(result, clip, masks)
    return replace(made, findings=(*made.findings, *result.notes[1:])), []


def _evaluate_meshes(job: OtherJob, clip: Clip, mesh_frame: MeshFrame) -> Evaluated:
    from getagrip.batch.job import failed_outcome
    from getagrip.clip import find_masks
    from getagrip.clip.match_frames import number_of
    from getagrip.metrics.evaluate import evaluate_meshes
    from getagrip.metrics.evaluate.external import read_meshes

    first, begin = job.first, clip.frames[0]
    if clip.name in job.frames:
        clip = clip.take(clip.index_of(job.frames[clip.name]))
    if first is not None:  # becomes the number of the first evaluated frame
        first += (number_of(clip.frames[0]) or 0) - (number_of(begin) or 0)
    meshes, errors = read_meshes(job.folder, clip, mesh_frame, first)
    return evaluate_meshes(meshes, clip, find_masks(clip), job.method), [failed_outcome("", error) for error in errors]
