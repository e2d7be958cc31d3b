"""Commands about sequences whose true poses are known: stable grasps, the study, the tables."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.cli.command import Clips, Command, Workers
from getagrip.errors import UsageError
from getagrip.grasps.options import GraspOptions
from getagrip.io.arguments import Flag, Folder, OptionalFile, OptionalFolder, one_of
from getagrip.io.terminal import report

if TYPE_CHECKING:
    from getagrip.grasps.cut import Cut


@dataclass(frozen=True, kw_only=True)
class GraspCommand(Command):
    """Options of the commands that find stable grasps."""

    clips: Clips = ()
    """Clip folders, or folders of clips: whole sequences, not cut to grasps already. No masks are needed."""
    grasps: Annotated[GraspOptions, arg(name="")] = field(default_factory=lambda: GraspOptions(contact_mm=0.0))
    """What counts as a stable grasp."""
    json: OptionalFile = None
    """Write every number here, unrounded."""
    workers: Workers = None
    """Processes to share the clips between."""

    def cut(self) -> Cut:
        """How the clips are cut to grasps."""
        return self.grasps.cut(report)


@dataclass(frozen=True, kw_only=True)
class Segment(GraspCommand):
    """Find the stable grasps in clips with true poses; or, in masks, all that the object does."""

    grasps: Annotated[GraspOptions, arg(name="")] = field(default_factory=GraspOptions)
    """What counts as a stable grasp."""
    from_masks: Flag = False
    """Read no true pose: find when the object lies still, moves in an unstable contact or is held in a stable grasp, by
    fits to masks and hand (docs/grasps.md)."""
    out: OptionalFolder = None
    """Write the list of grasps (grasps.json, segments.csv) and a picture of each clip here; with --from-masks all
    segments (segments.json) instead of pictures."""
    write: Flag = False
    """With --from-masks: write the segments into each clip.json, too, which makes a timeline of the clip."""
    overwrite: Flag = False
    """With --write: replace segments that clips have."""

    def run(self) -> int:
        if self.from_masks:
            from getagrip.commands.segment_masks import Write, find_in_clips

            if self.grasps.listed is not None:
                raise UsageError("--list: got a list, expected none with --from-masks")
            definition = self.grasps.definition(contact_mm=10.0)
            write = Write(self.overwrite) if self.write else None
            return find_in_clips(self.clips, definition, self.out, self.json, write, self.workers, self.debug)
        from getagrip.commands.segment import segment_clips

        if self.write:
            raise UsageError("--write: got it, expected it with --from-masks only")
        return segment_clips(self.clips, self.cut(), self.out, self.json, self.workers, self.debug)


@dataclass(frozen=True, kw_only=True)
class Study(GraspCommand):
    """Measure what changes within the stable grasps of clips with true poses, and outside them: the paper's study."""

    out: Folder
    """Where study.png, grasps.csv, curves.csv, summary.csv and the list of grasps (grasps.json) go."""

    def run(self) -> int:
        from getagrip.commands.study import study_clips

        return study_clips(self.clips, self.cut(), self.out, self.json, self.workers, self.debug)


@dataclass(frozen=True, kw_only=True)
class Stats(Command):
    """Print how long stable grasps last, category by category, and what a dataset has: the paper's dataset tables."""

    source: Annotated[Positional[str], arg(metavar="epic-grasps|LIST")]
    """epic-grasps, followed by its CSV; or a list of grasps, or the folder of clips that import wrote it into."""
    csv: Annotated[Positional[Path | None], arg(metavar="[CSV]", help_behavior_hint="")] = None
    """With epic-grasps: its table, as published."""
    errata: bool = False
    """epic-grasps: apply the errata that lie beside the table (<CSV>_errata.csv). The paper's table is without."""
    errata_file: OptionalFile = None
    """epic-grasps: the errata, where they lie elsewhere."""
    fps: Annotated[
        Literal["paper", "true"] | None, one_of("paper", "true"), arg(help_behavior_hint="(default: paper)")
    ] = None
    """epic-grasps: 50 frames per second in every video, as in the paper; or the rate at which EPIC numbers frames."""
    out: OptionalFolder = None
    """Write stats.md, stats.csv and counts.csv here."""
    json: OptionalFile = None
    """Write every number here, unrounded."""

    def run(self) -> int:
        from getagrip.commands.stats import print_stats

        return print_stats(self.source, self.csv, self.errata, self.errata_file, self.fps, self.out, self.json)
