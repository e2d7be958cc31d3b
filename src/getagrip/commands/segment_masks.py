"""``getagrip segment --from-masks``: what the object of uncut clips does, found without any 3D label of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.commands.command import for_each_clip
from getagrip.errors import UsageError
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.terminal import console, format_count, make_table, print_note

if TYPE_CHECKING:
    from rich.table import Table

    from getagrip.batch.job import Outcome, Progress
    from getagrip.clip import Clip
    from getagrip.clip.segment_files import SegmentList
    from getagrip.commands.segment import Segment
    from getagrip.grasps.definition import Definition
    from getagrip.grasps.lists import ListedGrasp
    from getagrip.segmentation.found import DetectedSegments

SEGMENTS_FILE = "segments.json"
SEGMENT_COLUMNS = ("sequence", "side", "object", "state", "start", "end", "duration", "first", "last", "margin")
"""Columns of ``segments.csv``: frames counted from 0, both included; seconds; names of the same frames; nats."""
MARGIN_LEGEND = (
    "margin: how much worse the best division without the segment explains the masks [nats]; small ones are uncertain"
)


@dataclass(frozen=True)
class MaskSegmentJob:
    """A clip to find segments in."""

    clip: Path
    definition: Definition
    write: bool = False
    """The segments go into ``clip.json``, too."""
    overwrite: bool = False
    """Also in the place of others."""


@dataclass(frozen=True)
class MaskSegmentedClip:
    """The segments found in a clip."""

    clip: str
    rows: tuple[Json, ...]
    """One for each segment, by ``SEGMENT_COLUMNS``."""
    fields: Json
    """Fields of ``segments.json``."""
    grasps: tuple[ListedGrasp, ...]


def segment_from_masks(options: Segment) -> int:
    """Print the segments of clips, found in their masks, and write them to files; 1 if any clip failed, else 0.

    ``out`` gets the grasps as a list, all segments as ``segments.csv``, and as ``clip.json`` has them, with margins, as
    ``segments.json``; ``json`` the list. Raises ``UsageError`` where there is nothing to do, and where two clips have
    the same name.
    """
    from getagrip.grasps import lists

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
    for path in filter(None, (options.json, out and out / lists.GRASP_LIST_FILE)):
        lists.write_listed_grasps(path, grasps, {"found in": "masks", **asdict(definition)})
    return 1 if failures else 0


def find_clip_segments(job: MaskSegmentJob, progress: Progress = lambda *_: None) -> MaskSegmentedClip | Outcome:
    """Find the segments of one clip; failures are returned, not raised."""
    from getagrip.batch.job import failed_outcome
    from getagrip.clip import read_clip, segment_files
    from getagrip.clip.reading import read_header
    from getagrip.grasps.cut import as_listed
    from getagrip.segmentation.cut import detected_segment_list
    from getagrip.segmentation.found import find_segments

    try:
        clip = read_clip(job.clip)
        if job.write:
            segment_files.check_segments_replaceable(read_header(job.clip), job.overwrite)
        found = find_segments(clip, None, job.definition, progress=lambda part: progress("fits", part))
        listed = detected_segment_list(clip, found)
        if job.write:
            segment_files.write_clip_segments(read_header(job.clip), listed)
    except Exception as error:  # one clip's trouble must not end the others
        return failed_outcome(job.clip.name, error)
    grasped = [
        (clip.with_side(one.segment.side), one.segment) for one in found.segments if one.segment.state == "grasp"
    ]
    grasps = tuple(as_listed(by or clip, segment.first, segment.last) for by, segment in grasped)
    return MaskSegmentedClip(clip.name, tuple(_segment_rows(clip, found)), _segment_json(listed, found), grasps)


def _segment_rows(clip: Clip, found: DetectedSegments) -> list[Json]:
    """Return the rows of the segments, by ``SEGMENT_COLUMNS``."""
    return [
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
    ]


def _segment_json(listed: SegmentList, found: DetectedSegments) -> Json:
    """Return the segments as ``clip.json`` has them, with the margins and what was assumed."""
    return listed.fields | {"margins": [one.margin for one in found.segments], "notes": list(found.notes)}


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
    """All segments, into the folder."""
    out.mkdir(parents=True, exist_ok=True)
    files.write_csv(out / "segments.csv", [SEGMENT_COLUMNS, *(row.values() for one in found for row in one.rows)])
    files.write_json(out / SEGMENTS_FILE, {one.clip: one.fields for one in found})
    print(out / "segments.csv", out / SEGMENTS_FILE, sep="\n")
