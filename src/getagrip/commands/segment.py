"""``getagrip segment``: the stable grasps of 3D-labelled clips, as a table, as files, and as pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from getagrip.batch.job import Outcome, Progress, failure
from getagrip.clip import read_clip
from getagrip.commands.each_clip import each_clip
from getagrip.grasps import lists
from getagrip.grasps.cut import Cut, as_listed
from getagrip.grasps.lists import ListedGrasp
from getagrip.io import files
from getagrip.io.counts import counted
from getagrip.io.csv_tables import CsvTable
from getagrip.io.terminal import console, plain_table, report

if TYPE_CHECKING:
    from rich.table import Table


COLUMNS = ("sequence", "side", "object", "start", "end", "duration", "first", "last")
"""Of ``segments.csv``: frames counted from 0, both included; seconds; names of the same frames."""


@dataclass(frozen=True)
class SegmentJob:
    """A clip to find grasps in."""

    clip: Path
    cut: Cut
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
    """First and last frame of each, both included."""
    listed: tuple[ListedGrasp, ...]
    """The same, as lists have them."""

    def rows(self) -> Iterator[dict[str, Any]]:
        """What ``segments.csv`` has of each grasp, by ``COLUMNS``."""
        for (start, end), grasp in zip(self.grasps, self.listed, strict=True):
            row = {"start": start, "end": end} | grasp.row()
            yield {column: row[column] for column in COLUMNS}


def segment_clips(
    paths: Sequence[Path],
    cut: Cut,
    out: Path | None,
    json: Path | None,
    workers: int | None,
    debug: bool,
) -> int:
    """Print the stable grasps of clips, and write them to files; 1 if any clip could not be read, else 0.

    A path is a clip, or a folder of clips. ``out`` gets the list as ``grasps.json`` and ``segments.csv``, and a picture
    for each clip; ``json`` the list. Raises ``UsageError`` where there is nothing to do, and where two clips have the
    same name.
    """

    def job(name: str, folder: Path) -> SegmentJob:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        return SegmentJob(folder, cut, None if out is None else out / f"{name}.png")

    in_order, failures = each_clip(paths, job, segment_one, workers, debug)
    if in_order:
        _print(in_order, out)
    grasps = [grasp for one in in_order for grasp in one.listed]
    tell_missing(cut, len(grasps))
    if out is not None:
        _write_csv(out / "segments.csv", [row for one in in_order for row in one.rows()])
    for path in filter(None, (json, out and out / lists.FILE)):
        lists.write(path, grasps, cut.record())
    return 1 if failures else 0


def segment_one(job: SegmentJob, progress: Progress = lambda *_: None) -> SegmentedClip | Outcome:
    """The grasps of one clip, drawn where a picture is wanted; or how it failed. Raises nothing."""
    try:
        clip = read_clip(job.clip)
        iou, grasps = job.cut.of(clip, partial(progress, "contact"))
        if job.picture is not None:
            from getagrip.pictures.matrix import write_matrix

            subtitle = f"{clip.side} hand, {clip.category}  ·  {job.cut.description}"
            write_matrix(job.picture, iou, grasps, clip.fps, job.cut.definition.tau, clip.name, subtitle)
        listed = tuple(as_listed(clip, first, last) for first, last in grasps)
        return SegmentedClip(clip.name, clip.side, clip.category, len(clip), clip.fps, tuple(grasps), listed)
    except Exception as error:  # one clip's trouble must not end the others
        return failure(job.clip.name, error)


def tell_missing(cut: Cut, found: int) -> None:
    """Report how many grasps of a list are not in the clips."""
    if cut.listed is not None and found < len(cut.listed.grasps):
        report(f"{found} of the {len(cut.listed.grasps)} grasps of {cut.listed.file} are in these clips")


def _print(found: Sequence[SegmentedClip], out: Path | None) -> None:
    """A table of all grasps, and their sum in a line."""
    console().print(_table(found))
    grasps = [end + 1 - start for one in found for start, end in one.grasps]
    held = sum(1 for one in found if one.grasps)
    share = 100.0 * sum(grasps) / sum(one.frames for one in found)
    of = counted(len(found), "clip")
    print(f"{counted(len(grasps), 'stable grasp')} in {held} of {of}, {share:.1f} % of their frames")
    if out is not None:
        print(out / "segments.csv")


def _table(found: Sequence[SegmentedClip]) -> Table:
    from rich.text import Text

    table = plain_table()
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


def _write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write the grasps as a table with ``COLUMNS``."""
    with files.new_text(path) as stream:
        table = CsvTable(stream)
        table.write_row(COLUMNS)
        table.write_rows(row.values() for row in rows)
