"""``getagrip study`` and ``stats``: changes within and outside stable grasps, and the tables of datasets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.cli.command import Command, for_each_clip
from getagrip.cli.segment import GraspCommand, SegmentJob, print_missing_grasps
from getagrip.errors import UsageError
from getagrip.io import files
from getagrip.io.options import Folder, OptionalFile, OptionalFolder, one_of
from getagrip.io.terminal import console, format_count, make_table, markdown_table, print_note

if TYPE_CHECKING:
    from getagrip.batch.job import Progress
    from getagrip.bench.tables import CategoryDurations, DatasetCounts
    from getagrip.stable_grasps.find import CutRules
    from getagrip.stable_grasps.study import Spread, StudiedGrasp

ALL_CATEGORIES_LABEL = "All"


@dataclass(frozen=True, kw_only=True)
class Study(GraspCommand):
    """Measure the changes within and outside the stable grasps of clips with true poses: the paper's study."""

    out: Folder
    """Folder of study.png, grasps.csv, curves.csv, summary.csv and the list of grasps (grasps.json)."""

    def run(self) -> int:
        """Study the stable grasps of clips, and write the measurements; return 1 if any clip failed, else 0.

        Raises ``UsageError`` without clips, and for two clips of the same name.
        """
        cut = self.cut()

        def job(_: str, folder: Path) -> SegmentJob:
            return SegmentJob(folder, cut)

        done, failures = for_each_clip(self.clips, job, study_one, self.workers, self.debug)
        studied = [grasp for grasps in done for grasp in grasps]
        print_missing_grasps(cut, len(studied))
        found, clips = format_count(len(studied), "stable grasp"), format_count(len(done), "clip")
        print(f"{found} in {sum(map(bool, done))} of {clips}")
        if studied:
            _print_study(studied)
            _write_study(studied, cut, len(done), self.out)
        if self.json is not None:
            files.write_json(self.json, _study_json(studied, cut))
        return 1 if failures else 0


def study_one(job: SegmentJob, progress: Progress = lambda *_: None) -> list[StudiedGrasp]:
    """Measure the grasps of one clip."""
    from getagrip.clip import read_clip
    from getagrip.stable_grasps.study import study_grasp

    clip = read_clip(job.clip)
    iou, grasps = job.cut.of(clip, partial(progress, "contact"))
    return [study_grasp(clip, iou, first, last) for first, last in grasps]


def by_category(studied: Sequence[StudiedGrasp]) -> Iterator[tuple[str, list[StudiedGrasp]]]:
    """Yield the grasps of each category in alphabetical order and, for several categories, all grasps."""
    categories = sorted({one.object for one in studied})
    for category in categories:
        yield category, [one for one in studied if one.object == category]
    if len(categories) > 1:
        yield ALL_CATEGORIES_LABEL, list(studied)


def _measure_spreads(studied: Sequence[StudiedGrasp], where: str) -> dict[str, Spread]:
    """Compute mean and spread of each measure, ``inside`` or ``outside`` of grasps."""
    from getagrip.stable_grasps.study import STUDY_MEASURES, Spread

    return {name: Spread.of([getattr(one, where)[name] for one in studied]) for name in STUDY_MEASURES}


def _print_study(studied: Sequence[StudiedGrasp]) -> None:
    """Print the approximations by category, and all measures inside and outside of grasps."""
    from rich.text import Text

    from getagrip.stable_grasps.study import STUDY_MEASURES

    table = make_table(title="error of the approximation, within grasps", title_style="")
    table.add_column("object", overflow="fold")
    for heading in ("grasps", "static", "1-DoF", "full pose, axis anywhere", "axis at the hand"):
        table.add_column(heading, justify="right")
    for category, grasps in by_category(studied):
        if category == ALL_CATEGORIES_LABEL:
            table.add_section()
        spreads = _measure_spreads(grasps, "inside").items()
        means = {name: spread.mean * STUDY_MEASURES[name].factor for name, spread in spreads}
        cells = [f"{means['static_rotation']:.1f}°", f"{means['one_dof_rotation']:.1f}°"]
        cells += [f"{means[f'{fit}_rotation']:.1f}°, {means[f'{fit}_place']:.1f} mm" for fit in ("free", "at_hand")]
        table.add_row(Text(category), str(len(grasps)), *cells)  # no markup: names may hold brackets
    console().print(table)

    table = make_table(title="mean ± standard deviation over grasps", title_style="")
    for heading in ("measure", "within", "outside", "unit"):
        table.add_column(heading, justify="left" if heading in ("measure", "unit") else "right")
    inside, outside = _measure_spreads(studied, "inside"), _measure_spreads(studied, "outside")
    for name, measure in STUDY_MEASURES.items():
        both = (_format_spread(spreads[name], name) for spreads in (inside, outside))
        table.add_row(measure.label, *both, measure.unit)
    console().print(table)
    print(f"with frames outside: {outside['static_rotation'].grasps} of {format_count(len(studied), 'grasp')}")


def _format_spread(spread: Spread, name: str) -> str:
    from getagrip.stable_grasps.study import STUDY_MEASURES

    factor, digits = STUDY_MEASURES[name].factor, 1 if STUDY_MEASURES[name].unit else 2
    return "-" if not spread.grasps else f"{spread.mean * factor:.{digits}f} ± {spread.std * factor:.{digits}f}"


def _write_study(studied: Sequence[StudiedGrasp], cut: CutRules, clips: int, out: Path) -> None:
    from getagrip.bench.figures.study_figure import write_study
    from getagrip.stable_grasps import grasp_lists
    from getagrip.stable_grasps.study import mean_curves

    out.mkdir(parents=True, exist_ok=True)
    _write_records_csv(out / "grasps.csv", (_grasp_record(one) for one in studied))
    _write_records_csv(out / "curves.csv", _curve_records(studied))
    _write_records_csv(out / "summary.csv", _spread_records(studied))
    grasp_lists.write_listed_grasps(out / grasp_lists.GRASP_LIST_FILE, [one.listed for one in studied], cut.record())
    title = f"{len(studied)} stable grasp{'s' * (len(studied) != 1)} in {clips} clip{'s' * (clips != 1)}"
    print(write_study(out / "study.png", mean_curves(studied), title, cut.description))


def _grasp_record(one: StudiedGrasp) -> dict[str, object]:
    """Return a grasp's row of ``grasps.csv``, in SI units."""
    axis = {f"axis_{name}_{x}": v for name in ("point", "direction") for x, v in zip("xyz", getattr(one.hinge, name))}  # noqa: B905
    fields = ("side", "object", "start", "end", "duration", "turned")
    return {
        "sequence": one.clip,
        **{name: getattr(one, name) for name in fields},
        **{f"inside_{name}": value for name, value in one.inside.items()},
        **{f"outside_{name}": value for name, value in one.outside.items()},
        **axis,
    }


def _curve_records(studied: Sequence[StudiedGrasp]) -> Iterator[dict[str, object]]:
    """Yield the mean curves, a row for each measure and normalised time, in SI units."""
    from getagrip.stable_grasps.study import NORMALISED_TIMES, mean_curves

    for name, spreads in mean_curves(studied).items():
        for time, spread in zip(NORMALISED_TIMES, spreads, strict=True):
            yield {"measure": name, "time": round(float(time), 6), **asdict(spread)}


def _spread_records(studied: Sequence[StudiedGrasp]) -> Iterator[dict[str, object]]:
    """Yield all measures inside and outside, by category, in SI units."""
    for category, grasps in by_category(studied):
        for where in ("inside", "outside"):
            for name, spread in _measure_spreads(grasps, where).items():
                yield {"object": category, "where": where, "measure": name, **asdict(spread)}


def _study_json(studied: Sequence[StudiedGrasp], cut: CutRules) -> dict[str, object]:
    return {
        "cut": cut.record(),
        "units": "SI: m, rad, s; measures without unit are shares",
        "summary": list(_spread_records(studied)),
        "grasps": [_grasp_record(one) for one in studied],
        "curves": list(_curve_records(studied)) if studied else [],
    }


def _write_records_csv(path: Path, rows: Iterable[dict[str, object]]) -> None:
    lines = list(rows)
    files.write_csv(path, [lines[0], *(line.values() for line in lines)])


EPIC_GRASPS_SOURCE = "epic-grasps"
STATS_HEADINGS = ("category", "avg [s]", "std [s]", "max [s]", "clips", "left", "right")


@dataclass(frozen=True, kw_only=True)
class Stats(Command):
    """Print the durations of stable grasps by category, and the counts of a dataset: the paper's dataset tables."""

    source: Annotated[Positional[str], arg(metavar="epic-grasps|LIST")]
    """The word epic-grasps, followed by its CSV; or a list of grasps; or a folder of clips that import made."""
    csv: Annotated[Positional[Path | None], arg(metavar="[CSV]", help_behavior_hint="")] = None
    """With epic-grasps: its table, as published."""
    errata: bool = False
    """With epic-grasps: apply the errata beside the table (<CSV>_errata.csv). The paper's table does not apply them."""
    errata_file: OptionalFile = None
    """With epic-grasps: the file of the errata, if it is not beside the table."""
    fps: Annotated[
        Literal["paper", "true"] | None, one_of("paper", "true"), arg(help_behavior_hint="(default: paper)")
    ] = None
    """With epic-grasps: durations at 50 frames per second in every video, as in the paper, or at the rate at which EPIC
    numbers frames (true)."""
    out: OptionalFolder = None
    """Write stats.md, stats.csv and counts.csv here."""
    json: OptionalFile = None
    """Write every number here, unrounded."""

    def run(self) -> int:
        """Print durations of grasps and counts of a dataset, and write them to files; return 0.

        Raises ``UsageError`` for options that fit neither EPIC-Grasps nor a list, and ``InputError``.
        """
        from getagrip.bench import tables
        from getagrip.readers.datasets.epic.epic_tables import chosen_errata, read_grasps
        from getagrip.stable_grasps import grasp_lists

        if self.source == EPIC_GRASPS_SOURCE:
            if self.csv is None:
                raise UsageError(f"missing CSV: {EPIC_GRASPS_SOURCE} needs the table of its grasps")
            chosen = chosen_errata(self.csv, self.errata or self.errata_file is not None, self.errata_file)
            if self.errata and chosen is None:
                lacking = self.csv.with_name(f"{self.csv.stem}_errata.csv")
                raise UsageError(f"missing {lacking}: --errata needs it, or --errata-file")
            grasps = read_grasps(self.csv, chosen)
            lasting = tables.epic_durations(grasps, self.fps or "paper")
            counted = tables.count_epic_grasps(grasps)
        else:
            if self.csv is not None:
                raise UsageError(f"{self.csv} cannot be used with {self.source}, only with {EPIC_GRASPS_SOURCE}")
            if self.errata or self.errata_file is not None:
                raise UsageError(f"--errata cannot be used with {self.source}, only with {EPIC_GRASPS_SOURCE}")
            if self.fps is not None:
                raise UsageError(f"--fps cannot be used with {self.source}: a list of grasps is in seconds")
            folder = Path(self.source) if Path(self.source).is_dir() else None
            path = Path(self.source) if folder is None else folder / grasp_lists.GRASP_LIST_FILE
            listed = grasp_lists.read_listed_grasps(path, print_note).grasps
            lasting, counted = tables.grasp_list_durations(path, listed), tables.count_grasp_list(listed, folder)
        rows = tables.durations_by_category(lasting)
        if not rows:
            print("no grasps")
        else:
            _print_stats(rows)
            print(", ".join(f"{number} {name}" for name, number in asdict(counted).items() if number is not None))
        if self.out is not None:
            _write_stats(rows, counted, self.out)
        if self.json is not None:
            files.write_json(self.json, {"durations": [asdict(row) for row in rows], "counts": asdict(counted)})
        return 0


def _stats_cells(row: CategoryDurations) -> list[str]:
    seconds = [f"{value:.2f}" for value in (row.mean, row.std, row.longest)]
    return [row.category, *seconds, str(row.clips), str(row.left), str(row.right)]


def _print_stats(rows: Sequence[CategoryDurations]) -> None:
    from rich.text import Text

    from getagrip.bench.tables import ALL_CATEGORIES_ROW

    shown = make_table()
    for n, heading in enumerate(STATS_HEADINGS):
        shown.add_column(Text(heading), justify="right" if n else "left", no_wrap=n > 0, overflow="fold")
    for row in rows:
        if row.category == ALL_CATEGORIES_ROW:
            shown.add_section()
        shown.add_row(*map(Text, _stats_cells(row)))  # no markup: names may hold brackets
    console().print(shown)


def _write_stats(rows: Sequence[CategoryDurations], counted: DatasetCounts, out: Path) -> None:
    """Write the tables as Markdown and, unrounded, as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    figures = {name: "-" if number is None else f"{number}" for name, number in asdict(counted).items()}
    grids = [STATS_HEADINGS, *map(_stats_cells, rows)], [list(figures), list(figures.values())]
    tables = ["\n".join(markdown_table(grid)) for grid in grids]
    files.write_text(out / "stats.md", "\n\n".join(tables) + "\n")
    files.write_csv(out / "counts.csv", [asdict(counted), asdict(counted).values()])
    heading = asdict(rows[0]) if rows else ()
    files.write_csv(out / "stats.csv", [heading, *(asdict(row).values() for row in rows)])
    print(out / "stats.md")
