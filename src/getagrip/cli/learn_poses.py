"""``getagrip init learn``: initial poses from the true poses of clips."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.cli.command import Clips, Command
from getagrip.errors import UsageError
from getagrip.io.options import File, OptionalFolder
from getagrip.io.terminal import format_count

if TYPE_CHECKING:
    from collections.abc import Sequence

    from getagrip.fitting.solver import cluster_poses as clusters


@dataclass(frozen=True, kw_only=True)
class LearnPoses(Command):
    """Learn initial poses from clips with true poses: rotations of each category in each hand."""

    clips: Clips = ()
    """Clip folders, or folders of clips."""
    out: File
    """File to write, for reconstruct --init clusters. A clip of one of its subjects then starts from the grasps of the
    others only."""
    k: int = 50
    """Number of rotations for each category and side."""
    leave_out: Annotated[tuple[str, ...], arg(metavar="SUBJECT...", help_behavior_hint="")] = ()
    """Subjects to leave out, on whose clips the poses will be tested."""
    as_folder: OptionalFolder = None
    """Also write poses learnt from all grasps into this folder, for reconstruct --init priors. As in the paper, a clip
    then starts from the grasps of its own subject as well."""
    way: Annotated[Literal["geodesic", "axis-angle"], arg(name="clusters")] = "geodesic"
    """k-means by the angles between rotations (geodesic) or, as in the paper, of rotation vectors (axis-angle)."""
    seed: Annotated[int, arg(metavar="S")] = 0
    """Seed of the random choices."""

    def check(self) -> None:
        from getagrip.io import files

        files.check_file("--out", self.out)
        if self.as_folder is not None:
            files.check_folder("--as-folder", self.as_folder)

    def run(self) -> int:
        """Learn initial poses from clips, without those of some subjects; return 1 if a clip could not be used, else 0.

        Raises ``UsageError`` if no clip is left, and for a subject of ``--leave-out`` that no clip has.
        """
        from getagrip.batch.clips import clips_by_name, print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.clip import read_clip
        from getagrip.fitting.solver import cluster_poses as clusters

        if not self.clips:
            raise UsageError("missing CLIP: name at least one clip")
        if not 1 <= self.k <= clusters.MAX_CLUSTERS:
            raise UsageError(f"--k must be 1 to {clusters.MAX_CLUSTERS} (got {self.k})")
        if not 0 <= self.seed < 2**63:
            raise UsageError(f"--seed must be 0 or more (got {self.seed})")
        clips, failed = clips_by_name(self.clips)
        poses = []
        for name, folder in clips.items():
            try:
                poses.append(clusters.true_grasp_pose(read_clip(folder)))
            except Exception as error:  # one clip's failure must not end the others
                failed.append(failed_outcome(name, error))
        for outcome in failed:
            print_outcome(outcome, self.debug)
        subjects = {pose.subject for pose in poses}
        if unknown := sorted({*self.leave_out} - subjects):
            known = ", ".join(sorted(subjects - {""})) or "none: the clips name no subject in their provenance"
            raise UsageError(f"unknown subject {', '.join(unknown)} of --leave-out; choose from {known}")
        kept = [pose for pose in poses if pose.subject not in self.leave_out]
        if not kept:
            raise UsageError("missing CLIP: no clip with true poses is left to learn from")
        grasps_learnt = clusters.LearntGrasps(tuple(kept), self.k, self.way, self.seed)
        learnt = grasps_learnt.poses()
        if self.as_folder is not None:
            learnt.write(self.as_folder)
        grasps_learnt.write(self.out)
        _print_counts(learnt, kept)
        whose = format_count(len(learnt.subjects), "subject") if learnt.subjects else "unknown subjects"
        made = f"{format_count(len(learnt.side), 'pose')} from {format_count(len(kept), 'clip')} of {whose}"
        print(f"{self.out}: {made}, {len(poses) - len(kept)} left out")
        if len(learnt.subjects) > 1:
            print("a clip of one of them starts from what is learnt without its subject")
        if self.as_folder is not None:
            print(f"{self.as_folder}: the same poses as a folder, which does not say what they were learnt from")
        if nameless := sum(not pose.subject for pose in kept):
            clips_in_words = format_count(nameless, "clip names", "clips name")
            print(f"{clips_in_words} no subject: each starts from the others, whoever they are", file=sys.stderr)
        return 1 if failed else 0


def _print_counts(learnt: clusters.PosePriors, kept: Sequence[clusters.TrueGraspPose]) -> None:
    """Print the number of poses and grasps for each category and side."""
    poses = Counter(zip(learnt.category, learnt.side, strict=True))
    grasps = Counter((pose.category, pose.side) for pose in kept)
    for key in sorted(poses):
        print(f"{', '.join(key)}: {format_count(poses[key], 'pose')} from {format_count(grasps[key], 'grasp')}")
