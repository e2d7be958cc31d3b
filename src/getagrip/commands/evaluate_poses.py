"""``getagrip evaluate --poses``: poses of the clip's mesh by another system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.batch.job import Outcome, failure
from getagrip.clip import find_masks, read_clip
from getagrip.clip.reading import read_name
from getagrip.errors import InputError
from getagrip.evaluation import evaluate
from getagrip.evaluation.other_poses import OtherSystem, poses_of
from getagrip.evaluation.pose_files import SUFFIXES
from getagrip.evaluation.results import Evaluation


@dataclass(frozen=True)
class OtherPoses:
    """Poses of another system."""

    root: Path
    """A file or folder of one clip's poses; or a folder that holds those of many, by name."""
    clips: Path
    """The folder that holds the clips by name, or the one clip."""
    first: int | None = None
    """The number of the first frame's pose; None where poses have the frames' numbers."""


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
    """As of ``OtherPoses``."""


def pose_jobs(poses: OtherPoses, frames: Mapping[str, tuple[str, ...]]) -> list[PoseJob]:
    """A job for each clip with poses. Raises ``InputError`` where there are none."""
    root, method = poses.root, poses.root.resolve().stem if poses.root.is_file() else poses.root.resolve().name
    if not root.exists():
        raise InputError(root, "", "no such file or folder", "poses of the object")
    if (poses.clips / "clip.json").is_file():
        name, one = read_name(poses.clips), root
        if root.is_dir() and any((root / f"{name}{suffix}").exists() for suffix in ("", *SUFFIXES)):
            one = OtherSystem(method, root).of_clip(name)
        return [PoseJob(one, poses.clips, method, frames, poses.first)]
    if root.is_file():
        return [PoseJob(root, poses.clips / root.stem, method, frames, poses.first)]
    places = [path for path in sorted(root.iterdir()) if path.is_dir() or path.suffix.lower() in SUFFIXES]
    if not places:
        raise InputError(root, "", "no poses in it", f"<clip>/, or <clip> with one of {', '.join(SUFFIXES)}")
    clips = [poses.clips / (path.name if path.is_dir() else path.stem) for path in places]
    if len(frames) == 1 and not any(clip.exists() for clip in clips):  # files of single frames
        return [PoseJob(root, poses.clips / next(iter(frames)), method, frames, poses.first)]
    return [PoseJob(path, clip, method, frames, poses.first) for path, clip in zip(places, clips, strict=True)]


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
