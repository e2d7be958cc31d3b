"""``getagrip evaluate --meshes``: the meshes of another system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.batch.job import Outcome, failure
from getagrip.clip import find_masks, read_clip
from getagrip.clip.naming import number_of
from getagrip.errors import InputError
from getagrip.evaluation import evaluate_meshes
from getagrip.evaluation.meshes import MeshFrame, read_meshes
from getagrip.evaluation.results import Evaluation
from getagrip.geometry.mesh_files import SUFFIXES


@dataclass(frozen=True)
class Meshes:
    """Meshes of another system, one for each frame of some clips."""

    root: Path
    """A folder for each clip, ``<clip>/<frame>.obj``, or that of one clip. Its name is the method's."""
    frame: MeshFrame
    clips: Path
    """The folder that holds the clips by name, or the one clip."""
    first: int | None = None
    """The number of the first frame's mesh; None where meshes have the frames' numbers."""


@dataclass(frozen=True)
class MeshJob:
    """The meshes of one clip to evaluate."""

    folder: Path
    clip: Path
    frame: MeshFrame
    method: str
    frames: Mapping[str, tuple[str, ...]]
    """By the names of clips: the frames to evaluate, where not all are."""
    first: int | None
    """As of ``Meshes``."""


def mesh_jobs(meshes: Meshes, frames: Mapping[str, tuple[str, ...]]) -> list[MeshJob]:
    """A job for each clip with meshes. Raises ``InputError`` where there are none."""
    if not meshes.root.is_dir():
        raise InputError(meshes.root, "", "no such folder", "a folder of meshes, <clip>/<frame>.obj")
    inside = sorted(meshes.root.iterdir())
    one = any(path.suffix.lower() in SUFFIXES for path in inside)
    folders = [meshes.root] if one else [path for path in inside if path.is_dir()]
    if not folders:
        raise InputError(meshes.root, "", "no meshes in it or in its folders", "<clip>/<frame>.obj")
    the_clip = (meshes.clips / "clip.json").is_file()
    if the_clip and len(folders) > 1:
        raise InputError(meshes.clips, "", "one clip", f"the folder of the clips of {len(folders)} folders of meshes")
    method = meshes.root.resolve().name
    clips = [meshes.clips if the_clip else meshes.clips / folder.name for folder in folders]
    return [
        MeshJob(folder, clip, meshes.frame, method, frames, meshes.first)
        for folder, clip in zip(folders, clips, strict=True)
    ]


def evaluate_clip_meshes(job: MeshJob) -> tuple[Evaluation | None, list[Outcome]]:
    """All metrics of the meshes of a clip, and what could not be read. Raises nothing."""
    try:
        clip, first = read_clip(job.clip), job.first
        begin = clip.frames[0]
        if clip.name in job.frames:
            clip = clip.take(np.array([clip.frames.index(frame) for frame in job.frames[clip.name]]))
        if first is not None:  # of the first of these frames
            first += (number_of(clip.frames[0]) or 0) - (number_of(begin) or 0)
        meshes, errors = read_meshes(job.folder, clip, job.frame, first)
        return evaluate_meshes(meshes, clip, find_masks(clip), job.method), [failure("", error) for error in errors]
    except Exception as error:  # one clip's trouble must not end the others
        return None, [failure("" if isinstance(error, InputError) else str(job.folder), error)]
