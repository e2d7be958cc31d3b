"""``getagrip reconstruct``: clips to results; with ``--find-grasps``, uncut clips to their segments first."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.batch.share import Batch
from getagrip.commands.command import Command, Sources
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io.arguments import Flag, placed
from getagrip.io.storage import Place, on_disk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from getagrip.batch.found import DetectedClip, FindJob

CLIPS = "clips"
"""Folder, in that of the results, of the clips with their segments, or of the grasps' own clips."""


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Command):
    """Reconstruct the pose of the object in the hand, in the frames of each clip."""

    clips: Sources = ()
    """Clip folders, folders of clips, or patterns in quotes; also in object stores: s3://BUCKET/FOLDER, gs://..."""
    out: Annotated[Place, placed("DIR"), arg(metavar="DIR")]
    """Folder of the results: a folder for each clip, of the clip's name. Existing valid results are kept. Several calls
    may share it at the same time. It may be in an object store, too."""
    options: Annotated[Options, arg(name="")] = field(default_factory=Options)
    find_grasps: Flag = False
    """For uncut clips: first find when the object lies still and when a hand holds it, as segment --from-masks does,
    then reconstruct the whole interaction as a timeline. Clips with their segments go to DIR/clips."""
    cut_grasps: Flag = False
    """Find segments as --find-grasps does, but reconstruct each stable grasp as a clip of its own. These clips go to
    DIR/clips, results to DIR/<clip>--1, --2 and so on."""
    batch: Annotated[Batch, arg(name="")] = field(default_factory=Batch)

    def run(self) -> int:
        from getagrip.batch.clips import reconstruct_clips

        if not (self.find_grasps or self.cut_grasps):
            return reconstruct_clips(self.clips, self.out, self.options, self.batch, self.debug)
        name = "--cut-grasps" if self.cut_grasps else "--find-grasps"
        return self._run_found([on_disk(name, clip) for clip in self.clips], on_disk(name, self.out))

    def _run_found(self, paths: Sequence[Path], out: Path) -> int:
        """Find the segments of clips in their masks and reconstruct each clip as a timeline into ``out/<clip>/``.

        With ``cut_grasps`` its stable grasps instead, each by itself, into ``out/<clip>--<n>/``; a clip without a grasp
        is no failure then. The clips that are reconstructed are written to ``out/clips``, which has a ledger of its
        own, and kept there also where results are made again. Returns 1 if any failed. Raises as ``reconstruct_clips``
        does, and ``UsageError`` for another method than timelines have.
        """
        from getagrip.batch.clips import print_outcome, reconstruct_clips
        from getagrip.batch.found import FindJob
        from getagrip.batch.plan import by_name
        from getagrip.batch.share import ALL
        from getagrip.timelines.footage import METHOD

        if not self.cut_grasps and self.options.method != METHOD:
            allowed = f"only {METHOD}, or any method with --cut-grasps"
            raise UsageError(f"--method {self.options.method} cannot be used with --find-grasps: {allowed}")
        if not paths:
            raise UsageError("missing CLIP: name at least one clip")
        if not self.cut_grasps and self.batch.keep.keep is not None:
            only = "a timeline has a probability for each grasp only; cut the grasps with --cut-grasps"
            raise UsageError(f"--keep cannot be used with --find-grasps: {only}")
        self.batch.keep.check(self.options)
        share = self.batch.share
        clips, failed = by_name(paths)
        for outcome in failed:
            print_outcome(outcome, self.debug)
        named = [(name, folder) for name, folder in clips.items() if name in share.shard]
        jobs = [FindJob(name, folder, out / CLIPS, self.options, self.cut_grasps) for name, folder in named]
        found = [] if share.fail_fast and failed else self._find(jobs, out)
        failures = len(failed) + len(jobs) - len(found)
        made = [folder for one in found for folder in one.folders]
        if not made or (share.fail_fast and failures):
            return 1 if failures else 0
        found_here = replace(self.batch, share=replace(share, shard=ALL))  # their clips are this shard's
        return max(int(failures > 0), reconstruct_clips(made, out, self.options, found_here, self.debug))

    def _find(self, jobs: Sequence[FindJob], out: Path) -> list[DetectedClip]:
        """Find the segments of each clip, in order, without clips that fail; print all of it."""
        from contextlib import closing

        from getagrip.batch.clips import print_outcome
        from getagrip.batch.engine import Engine
        from getagrip.batch.found import DetectedClip, entry_of, find_one, lost
        from getagrip.batch.job import load
        from getagrip.batch.ledger import Ledger
        from getagrip.io import files, leftovers
        from getagrip.io.terminal import report, say

        if not jobs:
            return []
        found: dict[str, DetectedClip] = {}
        share = self.batch.share
        leftovers.sweep(files.folder_inside(out, CLIPS))
        engine = Engine(
            work=find_one, lost=lost, entry=entry_of, options=[asdict(jobs[0].options), jobs[0].alone], prepare=load
        )
        with (
            Ledger(files.folder_inside(share.ledger or out, CLIPS)) as ledger,
            closing(share.ended(engine, jobs, len(jobs), ledger, "clips", stages=True)) as ends,
        ):
            for one in ends:
                if isinstance(one, DetectedClip):
                    say(str(one))
                    found[one.clip] = one
                    continue
                print_outcome(one, self.debug)
                if share.fail_fast:
                    report("--fail-fast: the other clips are skipped")
                    break
        return [found[job.name] for job in jobs if job.name in found]
