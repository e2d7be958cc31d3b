"""``getagrip segment``: stable grasps of clips with true poses; with ``--from-masks`` all states, from masks alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.cli.command import Clips, Command, Workers, for_each_clip
from getagrip.errors import UsageError
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.options import Flag, OptionalFile, OptionalFolder
from getagrip.io.terminal import console, format_count, make_table, print_note
from getagrip.stable_grasps.definition import GraspOptions

if TYPE_CHECKING:
    from rich.table import Table

    from getagrip.batch.job import Progress
    from getagrip.clip import Clip
    from getagrip.stable_grasps.definition import Definition
    from getagrip.stable_grasps.find import CutRules
    from getagrip.stable_grasps.grasp_lists import ListedGrasp
    from getagrip.timelines.detect.detect_segments import DetectedSegments

SEGMENTS_FILE = "segments.json"
SEGMENT_COLUMNS = ("sequence", "side", "object", "state", "start", "end", "duration", "first", "last", "margin")
"""Columns of ``segments.csv`` with ``--from-masks``: ``GRASP_COLUMNS``, the state, and the margin [nats]."""
GRASP_COLUMNS = ("sequence", "side", "object", "start", "end", "duration", "first", "last")
"""Columns of ``segments.csv``: indices of the first and last frame, seconds, and names of these frames."""
MARGIN_LEGEND = (
    "margin: how much worse the best division without the segment explains the masks [nats]; small ones are uncertain"
)


@dataclass(frozen=True)
class MaskSegmentJob:
    """A clip to find segments in."""

    clip: Path
    definition: Definition
    write: bool = False
    """Also write the segments into ``clip.json``."""
    overwrite: bool = False
    """Replace the segments in ``clip.json``."""


@dataclass(frozen=True)
class MaskSegmentedClip:
    """The segments found in a clip."""

    clip: str
    rows: tuple[Json, ...]
    """A row for each segment, by ``SEGMENT_COLUMNS``."""
    fields: Json
    """Fields of ``segments.json``: those of ``clip.json``, margins, and assumptions as notes."""
    grasps: tuple[ListedGrasp, ...]


def segment_from_masks(options: Segment) -> int:
    """Find segments in the masks of clips, print and write them; return 1 if any clip failed, else 0.

    ``out`` gets the list of grasps, and all segments as ``segments.csv`` and ``segments.json``; ``json`` the list.
    Raises ``UsageError`` without clips, and for two clips of the same name.
    """
    from getagrip.stable_grasps import grasp_lists

    if options.grasps.listed is not None:
        raise UsageError("--list cannot be used with --from-masks")
    definition, out = options.grasps.definition(contact_mm=10.0), options.out

    def job(_: str, folder: Path) -> MaskSegmentJob:
        if options.write and folder not in options.clips:
            files.refuse_link(folder)
        return MaskSegmentJob(folder, definition, options.write, options.overwrite)

    found, failures = for_each_clip(options.clips, job, find_clip_segments, options.workers, options.debug)
    if found:
        console().print(_segments_table(found))
        print(MARGIN_LEGEND)
    for one in found:
        for note in one.fields["notes"]:
            print_note(f"{one.clip}: {note}")
    grasps = [grasp for one in found for grasp in one.grasps]
    grasped = sum(bool(one.grasps) for one in found)
    print(f"{format_count(len(grasps), 'stable grasp')} in {grasped} of {format_count(len(found), 'clip')}")
    if out is not None:
        _write_segments(found, out)
    for path in filter(None, (options.json, out and out / grasp_lists.GRASP_LIST_FILE)):
        grasp_lists.write_listed_grasps(path, grasps, {"found in": "masks", **asdict(definition)})
    return 1 if failures else 0


def find_clip_segments(job: MaskSegmentJob, progress: Progress = lambda *_: None) -> MaskSegmentedClip:
    """Find the segments of one clip in its masks."""
    from getagrip.clip import read, read_clip
    from getagrip.clip.read import read_header
    from getagrip.stable_grasps.find import as_listed
    from getagrip.timelines.detect.detect_segments import detected_segment_list, find_segments

    clip = read_clip(job.clip)
    if job.write:
        read.check_segments_replaceable(read_header(job.clip), job.overwrite)
    found = find_segments(clip, None, job.definition, progress=lambda part: progress("fits", part))
    listed = detected_segment_list(clip, found)
    if job.write:
        read.write_clip_segments(read_header(job.clip), listed)
    grasped = [one.segment for one in found.segments if one.segment.state == "grasp"]
    grasps = tuple(as_listed(clip.with_side(one.side) or clip, one.first, one.last) for one in grasped)
    fields = listed.fields | {"margins": [one.margin for one in found.segments], "notes": list(found.notes)}
    return MaskSegmentedClip(clip.name, _segment_rows(clip, found), fields, grasps)


def _segment_rows(clip: Clip, found: DetectedSegments) -> tuple[Json, ...]:
    return tuple(
        {
            "sequence": clip.name,
            "side": one.segment.side or "",
            "object": clip.category,
            "state": one.segment.state,
            "start": one.segment.first,
            "end": one.segment.last,
            "duration": len(one.segment) / clip.fps,
            "first": clip.frames[one.segment.first],
            "last": clip.frames[one.segment.last],
            "margin": one.margin,
        }
        for one in found.segments
    )


def _segments_table(found: Sequence[MaskSegmentedClip]) -> Table:
    from rich.text import Text

    table = make_table()
    table.add_column("clip", overflow="fold")
    for heading in ("state", "hand"):
        table.add_column(heading)
    for heading in ("first", "last", "seconds", "margin"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in found:
        for row in one.rows:
            names = (Text(row[key]) for key in ("first", "last"))  # no markup: names may hold brackets
            numbers = f"{row['duration']:.2f}", f"{row['margin']:.0f}"
            table.add_row(Text(one.clip), row["state"], row["side"], *names, *numbers)
    return table


def _write_segments(found: Sequence[MaskSegmentedClip], out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    files.write_csv(out / "segments.csv", [SEGMENT_COLUMNS, *(row.values() for one in found for row in one.rows)])
    files.write_json(out / SEGMENTS_FILE, {one.clip: one.fields for one in found})
    print(out / "segments.csv", out / SEGMENTS_FILE, sep="\n")


@dataclass(frozen=True, kw_only=True)
class GraspCommand(Command):
    """Options of the commands that find stable grasps."""

    clips: Clips = ()
    """Clip folders, or folders of clips: whole sequences, not cut to grasps already. No masks are needed."""
    grasps: Annotated[GraspOptions, arg(name="")] = field(default_factory=lambda: GraspOptions(contact_mm=0.0))
    """Definition of a stable grasp."""
    json: OptionalFile = None
    """Write every number here, unrounded."""
    workers: Workers = None
    """Number of processes."""

    def cut(self) -> CutRules:
        """Return the rule by which the clips are cut to grasps."""
        return self.grasps.cut(print_note)


@dataclass(frozen=True, kw_only=True)
class Segment(GraspCommand):
    """Find the stable grasps in clips with true poses; or, from masks, all states of the object."""

    grasps: Annotated[GraspOptions, arg(name="")] = field(default_factory=GraspOptions)
    """Definition of a stable grasp."""
    from_masks: Flag = False
    """Find segments without true poses: when the object lies still, is in unstable contact or in a stable grasp, by
    fits to masks and hand (docs/grasps.md)."""
    out: OptionalFolder = None
    """Write the list of grasps (grasps.json, segments.csv) and a picture of each clip here; with --from-masks all
    segments (segments.json) instead of pictures."""
    write: Flag = False
    """With --from-masks: write the segments into each clip.json, too, which makes a timeline of the clip."""
    overwrite: Flag = False
    """With --write: replace segments that clips have."""

    def run(self) -> int:
        """Find the stable grasps of clips, print and write them; return 1 if any clip failed, else 0.

        ``out`` gets the list as ``grasps.json`` and ``segments.csv``, and a picture for each clip; ``json`` the list.
        Raises ``UsageError`` without clips, and for two clips of the same name.
        """
        from getagrip.stable_grasps import grasp_lists

        if self.from_masks:
            return segment_from_masks(self)
        if self.write:
            raise UsageError("missing --from-masks: --write writes the segments that it finds")
        cut = self.cut()

        def job(name: str, folder: Path) -> SegmentJob:
            if self.out is not None:
                self.out.mkdir(parents=True, exist_ok=True)
            return SegmentJob(folder, cut, None if self.out is None else self.out / f"{name}.png")

        in_order, failures = for_each_clip(self.clips, job, find_clip_grasps, self.workers, self.debug)
        if in_order:
            _print_grasps(in_order, self.out)
        grasps = [grasp for one in in_order for grasp in one.listed]
        print_missing_grasps(cut, len(grasps))
        if self.out is not None:
            rows = (row.values() for one in in_order for row in one.rows())
            files.write_csv(self.out / "segments.csv", [GRASP_COLUMNS, *rows])
        for path in filter(None, (self.json, self.out and self.out / grasp_lists.GRASP_LIST_FILE)):
            grasp_lists.write_listed_grasps(path, grasps, cut.record())
        return 1 if failures else 0


@dataclass(frozen=True)
class SegmentJob:
    """A clip to find grasps in."""

    clip: Path
    cut: CutRules
    picture: Path | None = None


@dataclass(frozen=True)
class SegmentedClip:
    """The grasps of a clip."""

    clip: str
    side: str
    object: str
    frames: int
    fps: float
    grasps: tuple[tuple[int, int], ...]
    """First and last frame of each grasp."""
    listed: tuple[ListedGrasp, ...]
    """Entries of the grasps for a list."""

    def rows(self) -> Iterator[Json]:
        """Yield the row of ``segments.csv`` of each grasp, by ``GRASP_COLUMNS``."""
        for (start, end), grasp in zip(self.grasps, self.listed, strict=True):
            row = {"start": start, "end": end} | grasp.row()
            yield {column: row[column] for column in GRASP_COLUMNS}


def find_clip_grasps(job: SegmentJob, progress: Progress = lambda *_: None) -> SegmentedClip:
    """Find the grasps of one clip, and draw them if the job names a picture."""
    from getagrip.clip import read_clip
    from getagrip.stable_grasps.find import as_listed

    clip = read_clip(job.clip)
    iou, grasps = job.cut.of(clip, partial(progress, "contact"))
    if job.picture is not None:
        from getagrip.bench.figures.contact_matrix import write_matrix

        subtitle = f"{clip.side} hand, {clip.category}  ·  {job.cut.description}"
        write_matrix(job.picture, iou, grasps, clip.fps, job.cut.definition.tau, clip.name, subtitle)
    listed = tuple(as_listed(clip, first, last) for first, last in grasps)
    return SegmentedClip(clip.name, clip.side, clip.category, len(clip), clip.fps, tuple(grasps), listed)


def print_missing_grasps(cut: CutRules, found: int) -> None:
    """Report grasps of a list that the clips lack."""
    if cut.listed is not None and found < len(cut.listed.grasps):
        print_note(f"{found} of the {len(cut.listed.grasps)} grasps of {cut.listed.file} are in these clips")


def _print_grasps(found: Sequence[SegmentedClip], out: Path | None) -> None:
    console().print(_grasps_table(found))
    grasps = [end + 1 - start for one in found for start, end in one.grasps]
    grasped = sum(1 for one in found if one.grasps)
    share = 100.0 * sum(grasps) / sum(one.frames for one in found)
    of = format_count(len(found), "clip")
    print(f"{format_count(len(grasps), 'stable grasp')} in {grasped} of {of}, {share:.1f} % of their frames")
    if out is not None:
        print(out / "segments.csv")


def _grasps_table(found: Sequence[SegmentedClip]) -> Table:
    from rich.text import Text

    table = make_table()
    table.add_column("clip", overflow="fold")
    table.add_column("hand")
    table.add_column("object", overflow="fold")
    for heading in ("first", "last", "seconds"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in found:
        name = (Text(one.clip), one.side, Text(one.object))  # no markup: names may hold brackets
        for grasp, (start, end) in zip(one.listed, one.grasps, strict=True):
            names = Text(str(grasp.first)), Text(str(grasp.last))
            table.add_row(*name, *names, f"{(end + 1 - start) / one.fps:.2f}")
        if not one.grasps:
            table.add_row(*name, "-", "-", "-")
    return table
