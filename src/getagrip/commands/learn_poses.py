"""``getagrip init learn``: starting poses from the true poses of clips."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failure
from getagrip.batch.plan import by_name
from getagrip.clip import read_clip
from getagrip.errors import UsageError
from getagrip.fitting import learn_priors as clusters
from getagrip.io.counts import counted


def learn(
    paths: Sequence[Path],
    out: Path,
    as_folder: Path | None,
    how: clusters.LearntGrasps,
    leave_out: Sequence[str],
    debug: bool,
) -> int:
    """Learn starting poses from clips, those of some subjects left out; 1 if a clip could not be used, else 0.

    ``how`` has no grasps yet. ``as_folder`` is where the poses are written, too.

    Raises ``UsageError`` where no clip is left, where no clip has a subject that is to be left out, and where the
    poses have no place as a folder.
    """
    if not paths:
        raise UsageError("CLIP: name at least one clip")
    if not 1 <= how.k <= clusters.MOST_CLUSTERS:
        raise UsageError(f"--k: got {how.k}, expected 1 to {clusters.MOST_CLUSTERS}")
    if not 0 <= how.seed < 2**63:
        raise UsageError(f"--seed: got {how.seed}, expected 0 or more")
    clips, failed = by_name(paths)
    holds = []
    for name, folder in clips.items():
        try:
            holds.append(clusters.hold(read_clip(folder)))
        except Exception as error:  # one clip's trouble must not end the others
            failed.append(failure(name, error))
    for outcome in failed:
        print_outcome(outcome, debug)
    subjects = {hold.subject for hold in holds}
    unknown = sorted({*leave_out} - subjects)
    if unknown:
        known = ", ".join(sorted(subjects - {""})) or "none: the clips name no subject in their provenance"
        raise UsageError(f"--leave-out: got {', '.join(unknown)}, expected subjects of the clips ({known})")
    kept = [hold for hold in holds if hold.subject not in leave_out]
    if not kept:
        raise UsageError("CLIP: no clip with true poses is left to learn from")
    grasps_learnt = replace(how, holds=tuple(kept))
    learnt = grasps_learnt.poses()
    if as_folder is not None:
        learnt.write(as_folder)
    grasps_learnt.write(out)
    _print_counts(learnt, kept)
    whose = counted(len(learnt.subjects), "subject") if learnt.subjects else "unknown subjects"
    made = f"{counted(len(learnt.side), 'pose')} from {counted(len(kept), 'clip')} of {whose}"
    print(f"{out}: {made}, {len(holds) - len(kept)} left out")
    if len(learnt.subjects) > 1:
        print("a clip of one of them starts from what is learnt without its subject")
    if as_folder is not None:
        print(f"{as_folder}: the same poses as a folder, which does not say what they were learnt from")
    nameless = sum(not hold.subject for hold in kept)
    if nameless:
        those = counted(nameless, "clip names", "clips name")
        print(f"{those} no subject: each starts from the others, whoever they are", file=sys.stderr)
    return 1 if failed else 0


def _print_counts(learnt: clusters.Priors, kept: Sequence[clusters.Hold]) -> None:
    """How many poses each category and side of hand has, and from how many grasps."""
    poses = Counter(zip(learnt.category, learnt.side, strict=True))
    grasps = Counter((hold.category, hold.side) for hold in kept)
    for key in sorted(poses):
        print(f"{', '.join(key)}: {counted(poses[key], 'pose')} from {counted(grasps[key], 'grasp')}")
