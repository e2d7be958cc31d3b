"""``getagrip reconstruct --find-grasps``: uncut clips to their segments, and these to results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.batch.clips import Batch, reconstruct_clips
from getagrip.batch.job import Outcome, Progress, failure
from getagrip.batch.plan import ALL
from getagrip.clip import read_clip, read_masks
from getagrip.commands.each_clip import each_clip
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io.terminal import say
from getagrip.timelines.reconstruct import METHOD

CLIPS = "clips"
"""Where the clips with their segments, or the grasps' own clips, go, in the folder of the results."""


@dataclass(frozen=True)
class FindJob:
    """A clip to find segments in."""

    clip: Path
    to: Path
    options: Options
    alone: bool
    """Whether each grasp becomes a clip of its own, or the whole a timeline."""


@dataclass(frozen=True)
class FoundClip:
    """What was found in a clip, as clips."""

    clip: str
    folders: tuple[Path, ...]
    spans: tuple[str, ...]
    """First and last frame of each, in words."""
    notes: tuple[str, ...]

    def __str__(self) -> str:
        found = f"stable grasps in {', '.join(self.spans)}" if self.spans else "no stable grasp"
        return f"{self.clip}: {'; '.join([found, *self.notes])}"


def reconstruct_found(
    paths: Sequence[Path], out: Path, options: Options, batch: Batch, alone: bool, debug: bool
) -> int:
    """Find the segments of clips in their masks and reconstruct each clip as a timeline into ``out/<clip>/``.

    With ``alone`` its stable grasps instead, each by itself, into ``out/<clip>--<n>/``; a clip without a grasp is no
    failure then. The clips that are reconstructed are written to ``out/clips``. Returns 1 if any failed. Raises
    ``UsageError`` as ``reconstruct_clips`` does, and for another method than timelines have.
    """
    if not alone and options.method != METHOD:
        raise UsageError(f"--method: got {options.method}, expected {METHOD}, or any with --cut-grasps")

    def job(name: str, folder: Path) -> FindJob | None:
        return FindJob(folder, out / CLIPS, options, alone) if name in batch.share.shard else None

    found, failures = each_clip(paths, job, find_one, batch.share.workers, debug)
    made: list[Path] = []
    for one in found:
        made += one.folders
        say(str(one))
    if not made:
        return 1 if failures else 0
    found_here = replace(batch, share=replace(batch.share, shard=ALL))  # their clips are this shard's
    return max(int(failures > 0), reconstruct_clips(made, out, options, found_here, debug))


def find_one(job: FindJob, progress: Progress = lambda *_: None) -> FoundClip | Outcome:
    """Find the segments of one clip and write them; or how it failed. Raises nothing."""
    from getagrip.segmentation.cut import write_grasps, write_timeline
    from getagrip.segmentation.found import find_segments

    try:
        clip = read_clip(job.clip)
        masks = read_masks(clip)
        found = find_segments(clip, masks, options=job.options, progress=lambda part: progress("grasps", part))
        spans = tuple(f"frames {clip.frames[first]} to {clip.frames[last]}" for first, last in found.grasps)
        write = write_grasps if job.alone else write_timeline
        return FoundClip(clip.name, tuple(write(clip, masks, found, job.to)), spans, found.notes)
    except Exception as error:  # one clip's trouble must not end the others
        return failure(job.clip.name, error)
