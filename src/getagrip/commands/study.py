"""``getagrip study``: what changes within stable grasps and outside them, as tables, as files, and as a picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.commands.command import for_each_clip
from getagrip.commands.segment import GraspCommand, SegmentJob, print_missing_grasps
from getagrip.io import files
from getagrip.io.arguments import Folder
from getagrip.io.terminal import console, format_count, make_table

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome, Progress
    from getagrip.grasps.cut import CutRules
    from getagrip.grasps.study import Spread, StudiedGrasp

ALL_CATEGORIES_LABEL = "All"


@dataclass(frozen=True, kw_only=True)
class Study(GraspCommand):
    """Measure the changes within and outside the stable grasps of clips with true poses: the paper's study."""

    out: Folder
    """Folder of study.png, grasps.csv, curves.csv, summary.csv and the list of grasps (grasps.json)."""

    def run(self) -> int:
        """Study the stable grasps of clips, and write the measurements to a folder; 1 if any clip failed, else 0.

        Raises ``UsageError`` where there is nothing to do, and where two clips have the same name.
        """
        cut = self.cut()

        def job(_: str, folder: Path) -> SegmentJob:
            return SegmentJob(folder, cut)

        done, failures = for_each_clip(self.clips, job, study_one, self.workers, self.debug)
        studied = [grasp for grasps in done for grasp in grasps]
        print_missing_grasps(cut, len(studied))
        print(
            f"{format_count(len(studied), 'stable grasp')} in {sum(map(bool, done))} of {format_count(len(done), 'clip')}"
        )
        if studied:
            _print_study(studied)
            _write_study(studied, cut, len(done), self.out)
        if self.json is not None:
            files.write_json(self.json, _study_json(studied, cut))
        return 1 if failures else 0


def study_one(job: SegmentJob, progress: Progress = lambda *_: None) -> list[StudiedGrasp] | Outcome:
    """Measure the grasps of one clip; failures are returned, not raised."""
    from getagrip.batch.job import failed_outcome
    from getagrip.clip import read_clip
    from getagrip.grasps.study import study_grasp

    try:
        clip = read_clip(job.clip)
        iou, grasps = job.cut.of(clip, partial(progress, "contact"))
        return [study_grasp(clip, iou, first, last) for first, last in grasps]
    except Exception as error:  # one clip's trouble must not end the others
        return failed_outcome(job.clip.name, error)


def by_category(studied: Sequence[StudiedGrasp]) -> Iterator[tuple[str, list[StudiedGrasp]]]:
    """Yield the grasps of each category in alphabetical order, then all of them where there are several categories."""
    categories = sorted({one.object for one in studied})
    for category in categories:
        yield category, [one for one in studied if one.object == category]
    if len(categories) > 1:
        yield ALL_CATEGORIES_LABEL, list(studied)


def _measure_spreads(studied: Sequence[StudiedGrasp], where: str) -> dict[str, Spread]:
    """Each measure over grasps, ``inside`` them or ``outside``."""
    from getagrip.grasps.study import STUDY_MEASURES, Spread

    return {name: Spread.of([getattr(one, where)[name] for one in studied]) for name in STUDY_MEASURES}


def _print_study(studied: Sequence[StudiedGrasp]) -> None:
    """Two tables: the approximations by category, and every measure inside and outside."""
    from rich.text import Text

    from getagrip.grasps.study import STUDY_MEASURES

    table = make_table(title="error of the approximation, within grasps", title_style="")
    table.add_column("object", overflow="fold")
    headings = ("grasps", "static", "1-DoF", "full pose, axis anywhere", "axis at the hand")
    for heading in headings:
        table.add_column(heading, justify="right")
    for category, grasps in by_category(studied):
        if category == ALL_CATEGORIES_LABEL:
            table.add_section()
        means = {
            name: spread.mean * STUDY_MEASURES[name].factor
            for name, spread in _measure_spreads(grasps, "inside").items()
        }
        cells = [f"{means['static_rotation']:.1f}°", f"{means['one_dof_rotation']:.1f}°"]
        cells += [f"{means[f'{fit}_rotation']:.1f}°, {means[f'{fit}_place']:.1f} mm" for fit in ("free", "at_hand")]
        table.add_row(Text(category), str(len(grasps)), *cells)  # no markup: names may hold brackets
    console().print(table)

    table = make_table(title="mean ± standard deviation over grasps", title_style="")
    for heading in ("measure", "within", "outside", "unit"):
        table.add_column(heading, justify="left" if heading in ("measure", "unit") else "right")
    inside, outside = _measure_spreads(studied, "inside"), _measure_spreads(studied, "outside")
    for name, measure in STUDY_MEASURES.items():
        table.add_row(
            measure.label, _format_spread(inside[name], name), _format_spread(outside[name], name), measure.unit
        )
    console().print(table)
    print(f"with frames outside: {outside['static_rotation'].grasps} of {format_count(len(studied), 'grasp')}")


def _format_spread(spread: Spread, name: str) -> str:
    """Mean and spread as people read them."""
    from getagrip.grasps.study import STUDY_MEASURES

    factor, digits = STUDY_MEASURES[name].factor, 1 if STUDY_MEASURES[name].unit else 2
    return "-" if not spread.grasps else f"{spread.mean * factor:.{digits}f} ± {spread.std * factor:.{digits}f}"


def _write_study(studied: Sequence[StudiedGrasp], cut: CutRules, clips: int, out: Path) -> None:
    """Write the files of a study."""
    from getagrip.grasps import lists
    from getagrip.grasps.study import mean_curves
    from getagrip.pictures.study import write_study

    out.mkdir(parents=True, exist_ok=True)
    _write_records_csv(out / "grasps.csv", (_grasp_record(one) for one in studied))
    _write_records_csv(out / "curves.csv", _curve_records(studied))
    _write_records_csv(out / "summary.csv", _spread_records(studied))
    lists.write_listed_grasps(out / lists.GRASP_LIST_FILE, [one.listed for one in studied], cut.record())
    title = f"{len(studied)} stable grasp{'s' * (len(studied) != 1)} in {clips} clip{'s' * (clips != 1)}"
    print(write_study(out / "study.png", mean_curves(studied), title, cut.description))


def _grasp_record(one: StudiedGrasp) -> dict[str, object]:
    """Return a grasp on one line, in SI units."""
    axis = {f"axis_{name}_{x}": v for name in ("point", "direction") for x, v in zip("xyz", getattr(one.hinge, name))}  # noqa: B905
    return {
        "sequence": one.clip,
        "side": one.side,
        "object": one.object,
        "start": one.start,
        "end": one.end,
        "duration": one.duration,
        "turned": one.turned,
        **{f"inside_{name}": value for name, value in one.inside.items()},
        **{f"outside_{name}": value for name, value in one.outside.items()},
        **axis,
    }


def _curve_records(studied: Sequence[StudiedGrasp]) -> Iterator[dict[str, object]]:
    """Yield the mean curves, a line for each normalised time and measure, in SI units."""
    from getagrip.grasps.study import NORMALISED_TIMES, mean_curves

    for name, spreads in mean_curves(studied).items():
        for time, spread in zip(NORMALISED_TIMES, spreads, strict=True):
            yield {"measure": name, "time": round(float(time), 6), **asdict(spread)}


def _spread_records(studied: Sequence[StudiedGrasp]) -> Iterator[dict[str, object]]:
    """Every measure inside and outside, by category, in SI units."""
    for category, grasps in by_category(studied):
        for where in ("inside", "outside"):
            for name, spread in _measure_spreads(grasps, where).items():
                yield {"object": category, "where": where, "measure": name, **asdict(spread)}


def _study_json(studied: Sequence[StudiedGrasp], cut: CutRules) -> dict[str, object]:
    """Everything, for ``--json``."""
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
