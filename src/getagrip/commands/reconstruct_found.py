"""``getagrip reconstruct --find-grasps``: uncut clips to their segments, and these to results."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from getagrip.batch.clips import Batch, print_outcome, reconstruct_clips, shown
from getagrip.batch.engine import Engine
from getagrip.batch.found import FindJob, FoundClip, entry_of, find_one, lost
from getagrip.batch.job import load
from getagrip.batch.ledger import Ledger
from getagrip.batch.plan import ALL, by_name
from getagrip.batch.progress import Pace
from getagrip.batch.share import Share
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io import files, leftovers
from getagrip.io.terminal import progress_bar, report, say
from getagrip.timelines.reconstruct import METHOD

CLIPS = "clips"
"""Where the clips with their segments, or the grasps' own clips, go, in the folder of the results."""


def reconstruct_found(
    paths: Sequence[Path], out: Path, options: Options, batch: Batch, alone: bool, debug: bool
) -> int:
    """Find the segments of clips in their masks and reconstruct each clip as a timeline into ``out/<clip>/``.

    With ``alone`` its stable grasps instead, each by itself, into ``out/<clip>--<n>/``; a clip without a grasp is no
    failure then. The clips that are reconstructed are written to ``out/clips``, which has a ledger of its own, and kept
    there also where results are made again. Returns 1 if any failed. Raises as ``reconstruct_clips`` does, and
    ``UsageError`` for another method than timelines have.
    """
    if not alone and options.method != METHOD:
        raise UsageError(f"--method: got {options.method}, expected {METHOD}, or any with --cut-grasps")
    if not paths:
        raise UsageError("CLIP: name at least one clip")
    share = batch.share
    clips, failed = by_name(paths)
    for outcome in failed:
        print_outcome(outcome, debug)
    named = [(name, folder) for name, folder in clips.items() if name in share.shard]
    jobs = [FindJob(name, folder, out / CLIPS, options, alone) for name, folder in named]
    found = [] if share.fail_fast and failed else _find(jobs, out, share, debug)
    failures = len(failed) + len(jobs) - len(found)
    made = [folder for one in found for folder in one.folders]
    if not made or (share.fail_fast and failures):
        return 1 if failures else 0
    found_here = replace(batch, share=replace(share, shard=ALL))  # their clips are this shard's
    return max(int(failures > 0), reconstruct_clips(made, out, options, found_here, debug))


def _find(jobs: Sequence[FindJob], out: Path, share: Share, debug: bool) -> list[FoundClip]:
    """What is found in each clip, in their order, without those that fail; all of it is printed."""
    if not jobs:
        return []
    found: dict[str, FoundClip] = {}
    leftovers.sweep(files.folder_inside(out, CLIPS))
    with Ledger(files.folder_inside(share.ledger or out, CLIPS)) as ledger, progress_bar() as bar:
        pace = Pace(bar, "clips", len(jobs))
        engine = Engine(
            work=find_one, lost=lost, entry=entry_of, options=[asdict(jobs[0].options), jobs[0].alone],
            crew=share.crew(len(jobs)), limits=share.limits, prepare=load, in_this=partial(shown, bar, find_one),
        )  # fmt: skip
        with closing(engine.run(jobs, ledger)) as ends:
            for one in ends:
                pace.count(entry_of(one).state)
                if isinstance(one, FoundClip):
                    say(str(one))
                    found[one.clip] = one
                    continue
                print_outcome(one, debug)
                if share.fail_fast:
                    report("--fail-fast: no other clip is begun")
                    break
    return [found[job.name] for job in jobs if job.name in found]
