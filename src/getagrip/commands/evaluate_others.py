"""``getagrip evaluate --poses``, ``--meshes``: another system's poses or meshes of clips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from getagrip.batch.job import Outcome, failed_outcome
from getagrip.clip import Clip, find_masks, read_clip
from getagrip.clip.naming import number_of
from getagrip.clip.reading import read_name
from getagrip.errors import InputError, UsageError
from getagrip.evaluation import evaluate, evaluate_meshes
from getagrip.evaluation.meshes import MeshFrame, read_meshes
from getagrip.evaluation.other_poses import read_external_poses
from getagrip.evaluation.results import Evaluation
from getagrip.geometry import mesh_files
from getagrip.io import files
from getagrip.object_poses.at_frames import poses_path_of_clip
from getagrip.object_poses.files import POSE_FILE_SUFFIXES

if TYPE_CHECKING:
    from getagrip.commands.evaluate import Evaluate

Frames = Mapping[str, tuple[str, ...]]
"""By the names of clips: the frames to evaluate, where not all are."""
Folders = Mapping[str, Path]
"""By the names of clips: the folders of those that results are of."""


@dataclass(frozen=True)
class OtherJob:
    """The poses or meshes of one clip to evaluate."""

    folder: Path
    """The file, or the folder."""
    clip: Path
    method: str
    frames: Frames
    first: int | None
    """The number of the first frame's pose or mesh; None where they have the frames' numbers."""
    mesh_frame: MeshFrame | None = None
    """That of meshes; None for poses."""


def mesh_jobs(options: Evaluate, frames: Frames, of_results: Folders = MappingProxyType({})) -> list[OtherJob]:
    """Make a job for each clip with meshes: ``<clip>/<frame>.obj``, or those of one clip.

    Raises ``InputError``, and ``UsageError`` where it is not known which clip they are of.
    """
    root, where = options.meshes, options.clips
    assert root is not None
    if not root.is_dir():
        raise InputError(root, "", "no such folder", "a folder of meshes, <clip>/<frame>.obj")
    folders = [root] if files.list_files(root, mesh_files.MESH_SUFFIXES) else files.folders_in(root)
    if not folders:
        raise InputError(root, "", "no meshes in it or in its folders", "<clip>/<frame>.obj")
    how = root.resolve().name, frames, options.first, options.mesh_frame
    if len(folders) == 1:
        return [OtherJob(folders[0], _find_clip(folders[0], where, of_results), *how)]
    if where is not None and _is_clip(where):
        raise InputError(where, "", "one clip", f"the folder of the clips of {len(folders)} folders of meshes")
    return [OtherJob(folder, _find_clip_by_name(folder.name, where, of_results), *how) for folder in folders]


def pose_jobs(options: Evaluate, frames: Frames, of_results: Folders = MappingProxyType({})) -> list[OtherJob]:
    """Make a job for each clip with poses, of one clip or of many by name.

    Raises ``InputError`` where there are none, and ``UsageError`` where it is not known which clip they are of.
    """
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
    """Return the clip that one file or folder is of: that of its name, else the only one that there are results of.

    Raises ``UsageError`` where there is neither.
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
    """Return the folder of a clip by its name: in ``--clips``, else that of a result, or one beside it.

    Raises ``UsageError`` where neither is known.
    """
    if where is not None and (where / name).exists():
        return where / name
    beside = where or next((folder.parent for folder in of_results.values()), None)
    if beside is None:
        raise UsageError("missing --clips: no result says where its clip is")
    return of_results.get(name, beside / name)


def evaluate_other(job: OtherJob) -> tuple[Evaluation | None, list[Outcome]]:
    """Evaluate another system's output for a clip; also return what could not be read. Raises nothing."""
    try:
        clip = read_clip(job.clip)
        return _evaluate_poses(job, clip) if job.mesh_frame is None else _evaluate_meshes(job, clip, job.mesh_frame)
    except Exception as error:  # one clip's trouble must not end the others
        return None, [failed_outcome("" if isinstance(error, InputError) else str(job.folder), error)]


def _evaluate_poses(job: OtherJob, clip: Clip) -> tuple[Evaluation, list[Outcome]]:
    masks = find_masks(clip)
    result = read_external_poses(job.folder, job.method, clip, masks, job.first)
    if clip.name in job.frames:
        index = clip.index_of(job.frames[clip.name])
        result, clip, masks = result.take(index), clip.take(index), masks and masks.take(index)
    made = evaluate(result, clip, masks)
    return replace(made, findings=(*made.findings, *result.notes[1:])), []


def _evaluate_meshes(job: OtherJob, clip: Clip, mesh_frame: MeshFrame) -> tuple[Evaluation, list[Outcome]]:
    first, begin = job.first, clip.frames[0]
    if clip.name in job.frames:
        clip = clip.take(np.array([clip.frames.index(frame) for frame in job.frames[clip.name]]))
    if first is not None:  # of the first of these frames
        first += (number_of(clip.frames[0]) or 0) - (number_of(begin) or 0)
    meshes, errors = read_meshes(job.folder, clip, mesh_frame, first)
    return evaluate_meshes(meshes, clip, find_masks(clip), job.method), [failed_outcome("", error) for error in errors]
