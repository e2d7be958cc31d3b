"""``getagrip reconstruct --find-grasps``: uncut clips to their stable grasps, and each of these to a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.batch.clips import Batch, print_outcome, reconstruct_clips
from getagrip.batch.job import Outcome, Progress, failure
from getagrip.batch.plan import ALL, by_name
from getagrip.clip import read_clip, read_masks
from getagrip.commands.segment import outcomes
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io.terminal import progress_bar

CLIPS = "clips"
"""Where the grasps' own clips go, in the folder of the results."""


@dataclass(frozen=True)
class CutJob:
    """A clip to cut to its grasps."""

    clip: Path
    to: Path
    options: Options


@dataclass(frozen=True)
class CutClip:
    """The grasps of a clip, each a clip of its own."""

    clip: str
    folders: tuple[Path, ...]
    spans: tuple[str, ...]
    """First and last frame of each, in words."""
    notes: tuple[str, ...]

    def __str__(self) -> str:
        found = f"stable grasps in {', '.join(self.spans)}" if self.spans else "no stable grasp"
        return f"{self.clip}: {'; '.join([found, *self.notes])}"


def reconstruct_found(paths: Sequence[Path], out: Path, options: Options, batch: Batch, debug: bool) -> int:
    """Find the stable grasps of clips in their masks and reconstruct each into ``out/<clip>--<n>/``; 1 if any failed.

    The grasps' clips are written to ``out/clips``. A clip without a grasp is no failure. Raises ``UsageError`` as
    ``reconstruct_clips`` does.
    """
    if not paths:
        raise UsageError("CLIP: name at least one clip")
    clips, failed = by_name(paths)
    for outcome in failed:
        print_outcome(outcome, debug)
    jobs = [CutJob(folder, out / CLIPS, options) for name, folder in clips.items() if name in batch.shard]
    cut: dict[Path, CutClip] = {}
    failures = len(failed)
    with progress_bar() as bar:
        for job, result in outcomes(cut_one, jobs, batch.workers, bar):
            if isinstance(result, CutClip):
                cut[job.clip] = result
            else:
                print_outcome(result, debug)
                failures += 1
    grasps: list[Path] = []
    for job in jobs:
        if job.clip in cut:
            grasps += cut[job.clip].folders
            print(cut[job.clip])
    if not grasps:
        return 1 if failures else 0
    found_here = replace(batch, shard=ALL)  # their clips are this shard's
    return max(int(failures > 0), reconstruct_clips(grasps, out, options, found_here, debug))


def cut_one(job: CutJob, progress: Progress = lambda *_: None) -> CutClip | Outcome:
    """Find the grasps of one clip and write them; or how it failed. Raises nothing."""
    from getagrip.segmentation.cut import write_grasps
    from getagrip.segmentation.found import find_segments

    try:
        clip = read_clip(job.clip)
        masks = read_masks(clip)
        found = find_segments(clip, masks, options=job.options, progress=lambda part: progress("grasps", part))
        spans = tuple(f"frames {clip.frames[first]} to {clip.frames[last]}" for first, last in found.grasps)
        return CutClip(clip.name, tuple(write_grasps(clip, masks, found, job.to)), spans, found.notes)
    except Exception as error:  # one clip's trouble must not end the others
        return failure(job.clip.name, error)
