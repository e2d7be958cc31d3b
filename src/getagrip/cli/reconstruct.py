"""``getagrip reconstruct``: results of clips; for uncut clips (``--find-grasps``) the segments are found first."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.batch.scheduling import BatchOptions
from getagrip.cli.command import Command, Sources
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io.options import Flag, place_argument
from getagrip.io.storage import Place, require_local_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from getagrip.batch.detect_job import DetectedClip, DetectionJob

CUT_CLIPS_FOLDER = "clips"
"""Subfolder of the results for the clips with their segments, or for the grasps as clips."""


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Command):
    """Reconstruct the pose of the object in the hand, in the frames of each clip."""

    clips: Sources = ()
    """Clip folders, folders of clips, or patterns in quotes; also in object stores: s3://BUCKET/FOLDER, gs://..."""
    out: Annotated[Place, place_argument("DIR"), arg(metavar="DIR")]
    """Folder of the results: a folder for each clip, of the clip's name. Existing valid results are kept. Several calls
    may share it at the same time. It may be in an object store, too."""
    options: Annotated[Options, arg(name="")] = field(default_factory=Options)
    find_grasps: Flag = False
    """For uncut clips: first find when the object lies still and when a hand holds it, as segment --from-masks does,
    then reconstruct the whole interaction as a timeline. Clips with their segments go to DIR/clips."""
    cut_grasps: Flag = False
    """Find segments as --find-grasps does, but reconstruct each stable grasp as a clip of its own. These clips go to
    DIR/clips, results to DIR/<clip>--1, --2 and so on."""
    batch: Annotated[BatchOptions, arg(name="")] = field(default_factory=BatchOptions)

    def run(self) -> int:
        from getagrip.batch.clips import reconstruct_clips

        if not (self.find_grasps or self.cut_grasps):
            return reconstruct_clips(self.clips, self.out, self.options, self.batch, self.debug)
        name = "--cut-grasps" if self.cut_grasps else "--find-grasps"
        clips = [require_local_path(name, clip) for clip in self.clips]
        return self._run_found(clips, require_local_path(name, self.out))

    def _run_found(self, paths: Sequence[Path], out: Path) -> int:
        """Find the segments of clips in their masks, and reconstruct each clip as a timeline into ``out/<clip>/``.

        With ``cut_grasps`` each stable grasp is reconstructed as its own clip into ``out/<clip>--<n>/``; a clip without
        grasps is then no failure. The reconstructed clips are written to ``out/clips``, which has its own ledger, and
        are kept when results are made again. Returns 1 if any failed. Raises as ``reconstruct_clips`` does, and
        ``UsageError`` for a method that timelines do not support.
        """
        from getagrip.batch.clips import clips_by_name, print_outcome, reconstruct_clips
        from getagrip.batch.detect_job import DetectionJob
        from getagrip.batch.scheduling import WHOLE_SHARD
        from getagrip.timelines.observations import TIMELINE_METHOD

        if not self.cut_grasps and self.options.method != TIMELINE_METHOD:
            allowed = f"only {TIMELINE_METHOD}, or any method with --cut-grasps"
            raise UsageError(f"--method {self.options.method} cannot be used with --find-grasps: {allowed}")
        if not paths:
            raise UsageError("missing CLIP: name at least one clip")
        if not self.cut_grasps and self.batch.keep.keep is not None:
            only = "a timeline has a probability for each grasp only; cut the grasps with --cut-grasps"
            raise UsageError(f"--keep cannot be used with --find-grasps: {only}")
        self.batch.keep.check(self.options)
        share = self.batch.share
        clips, failed = clips_by_name(paths)
        for outcome in failed:
            print_outcome(outcome, self.debug)
        own, clips_folder = {name: clips[name] for name in clips if name in share.shard}, out / CUT_CLIPS_FOLDER
        jobs = [DetectionJob(name, clip, clips_folder, self.options, self.cut_grasps) for name, clip in own.items()]
        found = [] if share.fail_fast and failed else self._find(jobs, out)
        failures = len(failed) + len(jobs) - len(found)
        made = [folder for one in found for folder in one.folders]
        if not made or (share.fail_fast and failures):
            return 1 if failures else 0
        found_here = replace(self.batch, share=replace(share, shard=WHOLE_SHARD))  # their clips are this shard's
        return max(int(failures > 0), reconstruct_clips(made, out, self.options, found_here, self.debug))

    def _find(self, jobs: Sequence[DetectionJob], out: Path) -> list[DetectedClip]:
        """Find and print the segments of each clip, in order; failures are printed and left out."""
        from contextlib import closing

        from getagrip.batch.clips import print_outcome
        from getagrip.batch.detect_job import DetectedClip, detect_clip_segments, detection_entry
        from getagrip.batch.engine import Engine
        from getagrip.batch.job import lost_outcome, preload_solver
        from getagrip.batch.ledger import Ledger
        from getagrip.io import files
        from getagrip.io.terminal import print_note, print_result

        if not jobs:
            return []
        found: dict[str, DetectedClip] = {}
        share = self.batch.share
        files.remove_stale_folders(files.folder_inside(out, CUT_CLIPS_FOLDER))
        options = [asdict(jobs[0].options), jobs[0].alone]
        engine = Engine(detect_clip_segments, lost_outcome, detection_entry, options, prepare=preload_solver)
        with (
            Ledger(files.folder_inside(share.ledger or out, CUT_CLIPS_FOLDER)) as ledger,
            closing(share.ended(engine, jobs, len(jobs), ledger, "clips", stages=True)) as ends,
        ):
            for one in ends:
                if isinstance(one, DetectedClip):
                    print_result(str(one))
                    found[one.clip] = one
                    continue
                print_outcome(one, self.debug)
                if share.fail_fast:
                    print_note("--fail-fast: the other clips are skipped")
                    break
        return [found[job.name] for job in jobs if job.name in found]
