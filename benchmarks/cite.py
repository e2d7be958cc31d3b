"""Results on pages: behind each ``<!-- {{ ... }} -->`` is, until ``<!-- end -->``, what ``results/`` has.

    {{ TABLE.ROW.COLUMN }}                   a number; words behind it ask for more: "0" (decimals), "unit", "interval"
    {{ TABLE.ROW.COLUMN difference }}        its difference from the row that it is compared with; "absolute": unsigned
    {{ TABLE.ROW.COLUMN minus=ROW }}         its difference from that of another row
    {{ table TABLE columns=A,B rows=GLOB }}  a table of some columns (all), of the rows that a glob names (all); words
                                             behind it: "interval", "difference" (of pairs), "notes"
    {{ inputs TABLE METHOD... }}             how often methods are right with each kind of input, in hand and camera,
                                             and their errors; METHOD=TABLE: of one that has a table of its own
    {{ headline TABLE METHOD METHOD=TABLE }} of these the four of README, by how hands are off
    {{ objects TABLE METHOD }}               how often a method is right with each object, its size, and the errors
    {{ methods COLUMN }}                     a column of all methods, by set of clips
    {{ leaderboard }}                        every method on every real motion, and what others printed
    {{ beside_paper }}                       the paper's Table 2, and its methods here, by its energy and by ours
    {{ motions }}                            the default on every real motion, and the probability without its objects
    {{ printed FILE }}                       others' numbers by part of a benchmark, in each column, with their sources
    {{ made TABLE }}                         at which commit, when, by which command

Beside the share that is below 10 % of the diameter every table has the error in mm, where it was measured: a large
object may be off by more. Keys of rows are their labels in small letters, with "-" for what is neither letter nor
digit. An unknown key is a ``KeyError``. ``python -m benchmarks.results`` writes README and docs/*.md anew; a test fails
where one is stale.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from fnmatch import fnmatch
from statistics import median

from benchmarks import store
from benchmarks.store import Cell, Column, Row
from getagrip.bench import tables as bench_tables
from getagrip.cli.reproduce import arctic_grasps
from getagrip.cli.reproduce.arctic_grasps import ARCTIC_BASELINES
from getagrip.cli.reproduce.paper_tables import published as paper_tables
from getagrip.cli.reproduce.reproduction import OWN_METHODS

PLACE = re.compile(r"\{\{ (.+?) \}\}")
WRITTEN = re.compile(r"<!-- \{\{ (.+?) \}\} -->(.*?)<!-- end -->", re.DOTALL)
METHODS = {
    "soft-hinge": "default",
    "one-dof": "`one-dof`, same filters",
    "contact-consistency": "`contact-consistency`",
    "paper": "`paper`",
}
INPUTS = {
    "exact": "as they are",
    "10 mm, 8°": "hands off by 10 mm and 8°",
    "strong": "hands off by more, also in depth and fingers (`strong`, assumed)",
    "estimated": "hands off as an estimator's were in images of ARCTIC (`estimated`)",
    "masks off by 2 px": "masks off by 2 px",
    "masks off by 4 px": "masks off by 4 px",
    "another object in 20 %": "masks of something else in one frame of five",
    "size unknown": "the object's size unknown",
    "category mesh": "a mesh that is only of the object's kind",
    "category mesh, size unknown, hands moderate": "the same, size unknown, hands off (`moderate`, assumed)",
}
"""Descriptions of the settings of the ablations ``inputs`` and ``final``."""
RIGHT, ERROR = "add_sym", "add_sym_mm"
"""Keys of the share of right results and of the error in mm, which are adjacent columns."""
ERROR_LABEL, WITHIN_MM = "median error, mm", 15
CLIPS = {
    "DexYCB": "dexycb-methods",
    "ARCTIC": "arctic-methods",
    "synthetic": "synthetic-methods",
    "`moderate`": "synthetic-moderate-methods",
    "`strong`": "synthetic-strong-methods",
    "`wild`": "synthetic-wild-methods",
    "`measured`": "synthetic-measured-methods",
}
"""Sets of clips for the comparison of methods, with their tables."""


MOTIONS = {
    "ARCTIC's motion": (("arctic-methods", "arctic-paper-methods"), ""),
    "DexYCB": (("dexycb-methods", "dexycb-paper-methods"), ""),
    "ten other objects": (("dexycb-other-final",), "-exact"),
    "HOT3D's and TACO's samples": (("samples-hot3d-taco-methods",), ""),
    "ARCTIC, estimated hands": (("arctic-motion-methods",), ""),
}
"""Real motions: tables, ours first, and the end of their rows' keys."""
PAPERS = {group: (method, ARCTIC_BASELINES.get(f"{group}, ours", OWN_METHODS.get(f"{group}, ours", group.lower())))
          for group, method in arctic_grasps.ARCTIC_PAPER_METHODS.items()}  # fmt: skip
"""The paper's methods with its energy, and our versions, by the names of its tables."""
DATASETS = {"ARCTIC's motion": "arctic", "DexYCB": "dexycb", "ten other objects": "dexycb-the-ten-others"}
"""Motions of the calibration of the probability, with their rows in its table."""


def fill(text: str) -> str:
    """Fill in the places of a page. Raises ``KeyError`` for an unknown key."""
    return PLACE.sub(lambda place: said(place[1]), text)


def fill_written(text: str) -> str:
    """Update the text behind each place of a page. Raises ``KeyError`` for an unknown key."""

    def again(place: re.Match[str]) -> str:
        words = said(place[1])
        apart = "\n" if words.startswith("|") or place[2].startswith("\n") else ""
        return f"<!-- {{{{ {place[1]} }}}} -->{apart}{words}{apart}<!-- end -->"

    return WRITTEN.sub(again, text)


def said(place: str) -> str:
    """Return the text of a place."""
    first, *words = place.split()
    if first in DIRECTIVES:
        return DIRECTIVES[first](*words)
    name, row, column = [*first.split("."), "", ""][:3]
    table = store.read(name)
    found = table.row(row, "differences" if "difference" in words else "rows")
    value = found.get(column)
    for other in (word.removeprefix("minus=") for word in words if word.startswith("minus=")):
        value, words = _first(value) - _first(table.row(other).get(column)), [*words, "difference"]
    return shown(table.column(column), value, words)


def _first(cell: Cell) -> float:
    """Return the number of a cell."""
    value = cell[0] if isinstance(cell, list) else cell
    if not isinstance(value, int | float):
        raise KeyError(f"minus= needs numbers (got {cell!r})")
    return float(value)


def shown(column: Column, cell: Cell, words: Sequence[str] = ()) -> str:
    """Format a cell."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, dict):
        return ", ".join(f"{name} {count}" for name, count in cell.items())
    digits = next((int(word) for word in words if word.isdigit()), column.digits)
    value, low, high, *_ = [*cell, None, None] if isinstance(cell, list) else [cell, None, None]
    unit = (" " if column.unit[:1].isalpha() or column.unit == "%" else "") + column.unit if "unit" in words else ""
    assert value is not None
    value = abs(value) if "absolute" in words else value
    signed = "+" if "difference" in words and "absolute" not in words else ""
    text = f"{value:{signed},.{digits}f}{unit}"
    if "interval" in words and low is not None and high is not None:
        ends = digits - 1 if column.unit == "%" and digits and not signed else digits
        text += f" [{low:{signed}.{ends}f}, {high:{signed}.{ends}f}]"
    return text.replace("-", "−")


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Make a Markdown table: first column left-aligned, numbers right-aligned."""
    rule = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *rows))


def table(name: str, *words: str) -> str:
    """Make a table of some columns and rows, the best of each column bold, with its provenance."""
    found = store.read(name)
    options = dict(word.split("=", 1) for word in words if "=" in word)
    among = "differences" if "difference" in words else "rows"
    keys = options["columns"].split(",") if "columns" in options else [column.key for column in found.columns]
    columns = [found.column(key) for key in _with_error(keys, found)]
    globs = options.get("rows", "*").split(",")
    rows = [row for glob in globs for row in getattr(found, among) if fnmatch(store.key_of(row), glob)]
    if not rows:
        raise KeyError(
            f"{name}: no row is {options.get('rows')}; choose from {', '.join(map(store.key_of, found.rows))}"
        )
    best = {column.key: _best(column, rows) for column in columns if among == "rows"}
    lines = []
    for row in rows:
        texts = [shown(column, row.get(column.key), words) for column in columns]
        marked = [f"**{t}**" if t == best.get(c.key) else t for c, t in zip(columns, texts, strict=True)]
        lines.append([_label(row), *marked])
    heads = ["", *map(_head, columns)]
    notes = [f"- {note}" for note in found.notes] if "notes" in words else []
    return "\n\n".join(filter(None, [grid(heads, lines), made(name), "\n".join(notes)]))


def _with_error(keys: Sequence[str], found: store.Table) -> list[str]:
    """Return columns, with the error in mm behind the share of right results if the table has it."""
    if RIGHT not in keys or all(column.key != ERROR for column in found.columns):
        return [*keys]
    return [key for each in keys if each != ERROR for key in ((RIGHT, ERROR) if each == RIGHT else (each,))]


def _head(column: Column) -> str:
    if column.key == ERROR:
        return ERROR_LABEL
    return column.label if column.unit in {"", column.label} else f"{column.label}, {column.unit}"


def _label(row: Row) -> str:
    return f"{row['label']} − {row['against']}" if "against" in row else str(row["label"])


def _best(column: Column, rows: Sequence[Row]) -> str | None:
    """Return the best printed value of a column; None if rows are equal or not compared by it."""
    values = [
        value[0] if isinstance(value, list) else value for row in rows if (value := row.get(column.key)) is not None
    ]
    numbers = [float(value) for value in values if isinstance(value, int | float)]
    if not column.best or len({round(value, column.digits) for value in numbers}) < 2:
        return None
    return shown(column, max(numbers) if column.best == "highest" else min(numbers))


def inputs(name: str, *methods: str) -> str:
    """Make a table of shares of right results, in the hand and in the camera, with a row for each kind of input."""
    found, lines = store.read(name), []
    rows, captions = {str(row["label"]): row for row in found.rows}, [made(name)]
    for method, of in (each.split("=") for each in methods if "=" in each):
        own = {str(row["label"]): row for row in store.read(of).rows}
        rows |= {label: row for label, row in own.items() if label.startswith(f"{method}, ")}
        captions.append(f"{METHODS[method]}, on {next(iter(own.values()))['clips']} clips: {made(of)}")
    methods = tuple(method.partition("=")[0] for method in methods)
    for setting, words in INPUTS.items():
        those = [rows.get(f"{method}, {setting}", {}) for method in methods]
        if any(those):
            keys = (RIGHT, ERROR, "right_in_camera")
            cells = [shown(found.column(key), row.get(key), ["0"] * (key != ERROR)) for key in keys for row in those]
            lines.append([words, str(next(row["clips"] for row in those if row)), *cells])
    labels = [METHODS[method] for method in methods]
    heads = [f"{label}{what}" for what in ("", ", mm", ", in the camera") for label in labels]
    return "\n\n".join([grid(["input", "clips", *heads], lines), *captions])


def headline(name: str, ours: str, theirs: str) -> str:
    """How often our default and the paper's method are right in the hand, and how far off, by the errors of hands."""
    method, _, of = theirs.partition("=")
    tables = store.read(name), store.read(of)
    lines, counts = [], ["", ""]
    for setting in ("exact", "10 mm, 8°", "strong", "estimated"):
        cells = []
        for n, (table, one) in enumerate(zip(tables, (ours, method), strict=True)):
            row = next(row for row in table.rows if row["label"] == f"{one}, {setting}")
            counts[n] = str(row["clips"])
            cells += [shown(table.column(key), row[key], ["0"] * (key != ERROR)) for key in (RIGHT, ERROR)]
        lines.append([INPUTS[setting], *cells])
    heads = [
        f"{METHODS[one]}, {count} clips: {what}"
        for one, count in zip((ours, method), counts, strict=True)
        for what in ("right, %", "mm")
    ]
    return grid(["hands", *heads], lines)


def objects(name: str, method: str) -> str:
    """Make a table of a method's share of right results by object, the smallest object first."""
    clips = [line for line in store.read_clips(name) if line["method"] == method]
    by_object = {
        label: [line for line in clips if line["category"] == label] for label in {c["category"] for c in clips}
    }
    lines = []
    for label, some in sorted(by_object.items(), key=lambda each: _median(each[1], "diameter_mm")):
        errors = [float(line["add_sym_mm"] or "nan") for line in some]
        lines.append([
            label.partition("_")[2].replace("_", " ") or label, f"{_median(some, 'diameter_mm'):.0f}", f"{len(some)}",
            f"{sum(line['add_sym_success'] == '1.0' for line in some)}", f"{_median(some, 'add_sym_mm'):.1f}",
            f"{max(errors):.0f}", f"{sum(error < WITHIN_MM for error in errors)}",
        ])  # fmt: skip
    heads = ["object", "diameter, mm", "clips", "right", ERROR_LABEL, "largest, mm", f"within {WITHIN_MM} mm"]
    return f"{grid(heads, lines)}\n\n{made(name)}"


def _median(lines: Sequence[dict[str, str]], key: str) -> float:
    return median(float(line[key]) for line in lines if line[key])


def methods(column: str) -> str:
    """Make a table of one metric: a row for each method, a column for each set of clips."""
    tables = {label: store.read(name) for label, name in CLIPS.items()}
    lines = [
        [f"`{row['label']}`", *(shown(t.column(column), t.row(store.key_of(row)).get(column)) for t in tables.values())]
        for row in tables["DexYCB"].rows
    ]
    lines.append(["clips", *(str(t.rows[0]["clips"]) for t in tables.values())])
    return grid(["", *CLIPS], lines)


def leaderboard() -> str:
    """Make a table of ADD and SCA-ADD of each method on each real motion, with inputs, time and hardware."""
    tables = {label: ([*map(store.read, names)], suffix) for label, (names, suffix) in MOTIONS.items()}
    lines = []
    for key in dict.fromkeys(
        store.key_of(row) for found, _ in tables.values() for table in found for row in table.rows
    ):
        rows = {label: _first_row(found, f"{key}{suffix}") for label, (found, suffix) in tables.items()}
        if rows["DexYCB"] is None:
            continue
        cells = ["–" if found is None else _both(*found) for found in rows.values()]
        table, row = rows["DexYCB"]
        seconds = shown(table.column("seconds"), row.get("seconds"))
        lines.append([f"`{key}`", "here", "hands, masks, CAD, K", *cells, seconds, "one CPU core", "MIT"])
    for group in PAPERS:
        cells = [" / ".join(_printed(group, "ADD", "SCA-ADD")), *("–" for _ in list(MOTIONS)[1:])]
        lines.append([group, "printed in the paper, Table 2", "the same, true hands", *cells, "–", "–", "–"])
    return grid(["method", "by", "given", *MOTIONS, "s", "runs on", "licence"], lines)


def beside_paper() -> str:
    """Make a table of the paper's Table 2 and the same methods here, with its energy and ours, on ARCTIC and DexYCB."""
    columns = {"IOU": "iou", "SCA-IOU": "sca_iou_0_8", "ADD": "add", "SCA-ADD": "sca_add"}
    lines = []
    for group, (by_paper, by_us) in PAPERS.items():
        lines.append([f"{group}, printed: ARCTIC", *_printed(group, *columns)])
        for motion in ("ARCTIC's motion", "DexYCB"):
            found = [*map(store.read, MOTIONS[motion][0])]
            for whose, method in (("by the paper's energy", by_paper), ("ours", by_us)):
                if (row := _first_row(found[::-1], method)) is not None:
                    cells = [shown(row[0].column(key), row[1].get(key)) for key in columns.values()]
                    lines.append([f"{group}, {whose}: {motion}", *cells])
    return grid(["", *columns], lines)


def _printed(group: str, *columns: str) -> list[str]:
    """Return the paper's printed means of a method over all clips of ARCTIC."""
    table = paper_tables()["Table 2"]
    return [f"{table['groups'][group]['All'][table['columns'].index(column)]:.1f}" for column in columns]


def motions() -> str:
    """Make a table of the default method on each real motion, with cross-validated AUROC and ECE of its probability."""
    columns = ("clips", "iou", "add", RIGHT, ERROR, "sca_add_sym", "right_in_camera", "seconds")
    fits = store.read("probability-hand")
    lines, heads = [], ["IOU", "ADD", "ADD sym.", ERROR_LABEL, "SCA-ADD sym.", "in the camera", "s"]
    for label, ((name, *_), suffix) in MOTIONS.items():
        found = store.read(name)
        row = found.row(f"soft-hinge{suffix}")
        cells = [shown(found.column(key), row.get(key)) for key in columns]
        fit = fits.row(DATASETS[label]) if label in DATASETS else None
        probable = (
            " / ".join(shown(fits.column(key), fit.get(key)) for key in ("auroc", "ece")) if fit else "no part in it"
        )
        lines.append([label, *cells, probable, str(found.made.get("commit", "–"))])
    return grid(["motion", "clips", *heads, "AUROC / ECE", "commit"], lines)


def _row(table: store.Table, key: str) -> Row | None:
    return next((row for row in table.rows if store.key_of(row) == key), None)


def _first_row(tables: Sequence[store.Table], key: str) -> tuple[store.Table, Row] | None:
    """Return the first table with a row, and the row."""
    found = ((table, _row(table, key)) for table in tables)
    return next(((table, row) for table, row in found if row is not None), None)


def _both(table: store.Table, row: Row) -> str:
    keys = [key for key in ("add", "sca_add", ERROR) if key in row]
    return " / ".join(shown(table.column(key), row.get(key)) for key in keys)


def made(name: str) -> str:
    """Describe the provenance of a table in a line."""
    how = store.read(name).made
    when = f"Commit {how['commit']}, {how['date']}" if "commit" in how else how.get("date", "")
    return f"*{when}: `{how['command']}`*" if "command" in how else f"*{when}*"


DIRECTIVES: dict[str, Callable[..., str]] = {
    "table": table,
    "inputs": inputs,
    "headline": headline,
    "objects": objects,
    "methods": methods,
    "leaderboard": leaderboard,
    "beside_paper": beside_paper,
    "motions": motions,
    "printed": lambda name: "\n".join(bench_tables.published_markdown(bench_tables.read_published_results(name), {})),
    "made": made,
}
