"""``getagrip evaluate --poses``, ``--meshes``: another system's poses or meshes of clips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from getagrip.batch.job import Outcome, failure
from getagrip.clip import Clip, find_masks, read_clip
from getagrip.clip.naming import number_of
from getagrip.clip.reading import read_name
from getagrip.errors import InputError, UsageError
from getagrip.evaluation import evaluate, evaluate_meshes
from getagrip.evaluation.meshes import MeshFrame, read_meshes
from getagrip.evaluation.other_poses import poses_of
from getagrip.evaluation.results import Evaluation
from getagrip.geometry import mesh_files
from getagrip.io import files
from getagrip.object_poses.at_frames import place_of
from getagrip.object_poses.files import SUFFIXES

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
    folders = [root] if files.listed(root, mesh_files.SUFFIXES) else files.folders_in(root)
    if not folders:
        raise InputError(root, "", "no meshes in it or in its folders", "<clip>/<frame>.obj")
    how = root.resolve().name, frames, options.first, options.mesh_frame
    if len(folders) == 1:
        return [OtherJob(folders[0], _clip_of(folders[0], where, of_results), *how)]
    if where is not None and _is_clip(where):
        raise InputError(where, "", "one clip", f"the folder of the clips of {len(folders)} folders of meshes")
    return [OtherJob(folder, _clip_named(folder.name, where, of_results), *how) for folder in folders]


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
        if root.is_dir() and any((root / f"{name}{suffix}").exists() for suffix in ("", *SUFFIXES)):
            one = place_of(root, name)
        return [OtherJob(one, where, *how)]
    if root.is_file():
        return [OtherJob(root, _clip_of(root, where, of_results), *how)]
    places = sorted([*files.folders_in(root), *files.listed(root, SUFFIXES)])
    if not places:
        raise InputError(root, "", "no poses in it", f"<clip>/, or <clip> with one of {', '.join(SUFFIXES)}")
    named = [path.name if path.is_dir() else path.stem for path in places]
    clips = [_clip_named(name, where, of_results) for name in named]
    if len(frames) == 1 and not any(clip.exists() for clip in clips):  # files of single frames
        return [OtherJob(root, _clip_named(next(iter(frames)), where, of_results), *how)]
    return [OtherJob(path, clip, *how) for path, clip in zip(places, clips, strict=True)]


def _is_clip(folder: Path) -> bool:
    return (folder / "clip.json").is_file()


def _clip_of(place: Path, where: Path | None, of_results: Folders) -> Path:
    """Return the clip that one file or folder is of: that of its name, else the only one that there are results of.

    Raises ``UsageError`` where there is neither.
    """
    if where is not None and _is_clip(where):
        return where
    named = _clip_named(place.stem if place.is_file() else place.name, where, of_results)
    if _is_clip(named):
        return named
    if len(of_results) == 1:
        return next(iter(of_results.values()))
    known = f"; the results are of {', '.join(sorted(of_results))}" if of_results else ""
    raise UsageError(f"which clip is {place} of? Name it: --clips CLIP{known}")


def _clip_named(name: str, where: Path | None, of_results: Folders) -> Path:
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
        return _poses(job, clip) if job.mesh_frame is None else _meshes(job, clip, job.mesh_frame)
    except Exception as error:  # one clip's trouble must not end the others
        return None, [failure("" if isinstance(error, InputError) else str(job.folder), error)]


def _poses(job: OtherJob, clip: Clip) -> tuple[Evaluation, list[Outcome]]:
    masks = find_masks(clip)
    result = poses_of(job.folder, job.method, clip, masks, job.first)
    if clip.name in job.frames:
        index = clip.index_of(job.frames[clip.name])
        result, clip, masks = result.take(index), clip.take(index), masks and masks.take(index)
    made = evaluate(result, clip, masks)
    return replace(made, findings=(*made.findings, *result.notes[1:])), []


def _meshes(job: OtherJob, clip: Clip, mesh_frame: MeshFrame) -> tuple[Evaluation, list[Outcome]]:
    first, begin = job.first, clip.frames[0]
    if clip.name in job.frames:
        clip = clip.take(np.array([clip.frames.index(frame) for frame in job.frames[clip.name]]))
    if first is not None:  # of the first of these frames
        first += (number_of(clip.frames[0]) or 0) - (number_of(begin) or 0)
    meshes, errors = read_meshes(job.folder, clip, mesh_frame, first)
    return evaluate_meshes(meshes, clip, find_masks(clip), job.method), [failure("", error) for error in errors]
