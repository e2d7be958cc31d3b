"""``getagrip evaluate --poses``: poses of the clip's mesh by another system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.batch.job import Outcome, failure
from getagrip.clip import find_masks, read_clip
from getagrip.clip.reading import read_name
from getagrip.errors import InputError
from getagrip.evaluation import evaluate
from getagrip.evaluation.other_poses import OtherSystem, poses_of
from getagrip.evaluation.pose_files import SUFFIXES
from getagrip.evaluation.results import Evaluation

if TYPE_CHECKING:
    from getagrip.commands.evaluate import Evaluate


@dataclass(frozen=True)
class PoseJob:
    """The poses of one clip to evaluate."""

    folder: Path
    """The file, or the folder."""
    clip: Path
    method: str
    frames: Mapping[str, tuple[str, ...]]
    """By the names of clips: the frames to evaluate, where not all are."""
    first: int | None
    """The number of the first frame's pose; None where poses have the frames' numbers."""


def pose_jobs(options: Evaluate, frames: Mapping[str, tuple[str, ...]]) -> list[PoseJob]:
    """A job for each clip with poses, of one clip or of many by name. Raises ``InputError`` where there are none."""
    root, where, first = options.poses, options.clips, options.first
    assert root is not None
    assert where is not None
    method = root.resolve().stem if root.is_file() else root.resolve().name
    if not root.exists():
        raise InputError(root, "", "no such file or folder", "poses of the object")
    if (where / "clip.json").is_file():
        name, one = read_name(where), root
        if root.is_dir() and any((root / f"{name}{suffix}").exists() for suffix in ("", *SUFFIXES)):
            one = OtherSystem(method, root).of_clip(name)
        return [PoseJob(one, where, method, frames, first)]
    if root.is_file():
        return [PoseJob(root, where / root.stem, method, frames, first)]
    places = [path for path in sorted(root.iterdir()) if path.is_dir() or path.suffix.lower() in SUFFIXES]
    if not places:
        raise InputError(root, "", "no poses in it", f"<clip>/, or <clip> with one of {', '.join(SUFFIXES)}")
    clips = [where / (path.name if path.is_dir() else path.stem) for path in places]
    if len(frames) == 1 and not any(clip.exists() for clip in clips):  # files of single frames
        return [PoseJob(root, where / next(iter(frames)), method, frames, first)]
    return [PoseJob(path, clip, method, frames, first) for path, clip in zip(places, clips, strict=True)]


def evaluate_clip_poses(job: PoseJob) -> tuple[Evaluation | None, list[Outcome]]:
    """All metrics of the poses of a clip, or why there are none. Raises nothing."""
    try:
        clip = read_clip(job.clip)
        masks = find_masks(clip)
        result = poses_of(job.folder, job.method, clip, masks, job.first)
        if clip.name in job.frames:
            index = clip.index_of(job.frames[clip.name])
            result, clip, masks = result.take(index), clip.take(index), masks and masks.take(index)
        made = evaluate(result, clip, masks)
        return replace(made, findings=(*made.findings, *result.notes[1:])), []
    except Exception as error:  # one clip's trouble must not end the others
        return None, [failure("" if isinstance(error, InputError) else str(job.folder), error)]
