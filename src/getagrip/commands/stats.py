"""``getagrip stats``: the dataset tables, on the screen and as files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.commands.command import Command
from getagrip.errors import UsageError
from getagrip.io import files
from getagrip.io.arguments import OptionalFile, OptionalFolder, one_of
from getagrip.io.tables import markdown_table
from getagrip.io.terminal import console, make_table, print_note

if TYPE_CHECKING:
    from getagrip.experiments.dataset_tables import CategoryDurations, DatasetCounts

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
        """Print how long the grasps of a dataset last and what it has, and write it to files; returns 0.

        Raises ``UsageError`` for calls that fit neither EPIC-Grasps nor a list, and ``InputError``.
        """
        from getagrip.datasets.epic.tables import chosen_errata, read_grasps
        from getagrip.experiments import dataset_tables as tables
        from getagrip.grasps import lists

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
            path = Path(self.source) if folder is None else folder / lists.GRASP_LIST_FILE
            listed = lists.read_listed_grasps(path, print_note).grasps
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
    """Return a row as text."""
    seconds = [f"{value:.2f}" for value in (row.mean, row.std, row.longest)]
    return [row.category, *seconds, str(row.clips), str(row.left), str(row.right)]


def _print_stats(rows: Sequence[CategoryDurations]) -> None:
    from rich.text import Text

    from getagrip.experiments.dataset_tables import ALL_CATEGORIES_ROW

    shown = make_table()
    for n, heading in enumerate(STATS_HEADINGS):
        shown.add_column(Text(heading), justify="right" if n else "left", no_wrap=n > 0, overflow="fold")
    for row in rows:
        if row.category == ALL_CATEGORIES_ROW:
            shown.add_section()
        shown.add_row(*map(Text, _stats_cells(row)))  # no markup: names may hold brackets
    console().print(shown)


def _write_stats(rows: Sequence[CategoryDurations], counted: DatasetCounts, out: Path) -> None:
    """Write the table as Markdown, and unrounded as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    figures = {name: "-" if number is None else f"{number}" for name, number in asdict(counted).items()}
    grids: list[list[Sequence[str]]] = [
        [STATS_HEADINGS, *map(_stats_cells, rows)],
        [list(figures), list(figures.values())],
    ]
    tables = ["\n".join(markdown_table(grid)) for grid in grids]
    files.write_text(out / "stats.md", "\n\n".join(tables) + "\n")
    files.write_csv(out / "counts.csv", [asdict(counted), asdict(counted).values()])
    heading = asdict(rows[0]) if rows else ()
    files.write_csv(out / "stats.csv", [heading, *(asdict(row).values() for row in rows)])
    print(out / "stats.md")
