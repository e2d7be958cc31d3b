"""``getagrip evaluate --meshes``: the meshes of another system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from getagrip.batch.job import Outcome, failure
from getagrip.clip import find_masks, read_clip
from getagrip.clip.naming import number_of
from getagrip.errors import InputError
from getagrip.evaluation import evaluate_meshes
from getagrip.evaluation.meshes import MeshFrame, read_meshes
from getagrip.evaluation.results import Evaluation
from getagrip.geometry.mesh_files import SUFFIXES

if TYPE_CHECKING:
    from getagrip.commands.evaluate import Evaluate


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
    """The number of the first frame's mesh; None where meshes have the frames' numbers."""


def mesh_jobs(options: Evaluate, frames: Mapping[str, tuple[str, ...]]) -> list[MeshJob]:
    """A job for each clip with meshes: ``<clip>/<frame>.obj``, or those of one clip. Raises ``InputError``."""
    root, where = options.meshes, options.clips
    assert root is not None
    assert where is not None
    assert options.mesh_frame is not None
    if not root.is_dir():
        raise InputError(root, "", "no such folder", "a folder of meshes, <clip>/<frame>.obj")
    inside = sorted(root.iterdir())
    one = any(path.suffix.lower() in SUFFIXES for path in inside)
    folders = [root] if one else [path for path in inside if path.is_dir()]
    if not folders:
        raise InputError(root, "", "no meshes in it or in its folders", "<clip>/<frame>.obj")
    the_clip = (where / "clip.json").is_file()
    if the_clip and len(folders) > 1:
        raise InputError(where, "", "one clip", f"the folder of the clips of {len(folders)} folders of meshes")
    method = root.resolve().name
    clips = [where if the_clip else where / folder.name for folder in folders]
    return [
        MeshJob(folder, clip, options.mesh_frame, method, frames, options.first)
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
