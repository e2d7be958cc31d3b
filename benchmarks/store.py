"""Tables of results: ``results/*.json``, the only store of measurements; a file per table, a line per row.

``results/clips/TABLE.csv.gz`` has a table's numbers by clip, where they were kept.
"""

from __future__ import annotations

import csv
import gzip
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results"
CLIPS = RESULTS / "clips"

Cell = float | str | list[float | None] | dict[str, int] | None
"""A number, a text, a value with the ends of its interval (and its count), counts by name, or nothing."""
Row = Mapping[str, Cell]
"""Cells by the keys of the columns, and the row's label."""

INTERVAL = re.compile(r"(\S+?)(?: \[(\S+), (\S+)\])?(?: \(n = (\d+)\))?")
NUMBER = re.compile(r"[+−-]?\d[\d,]*(\.\d+)?")
MARKUP = re.compile(r"</?su[bp]>|</?u>|\*\*")
UNITS = {"%", "mm", "m", "px", "°", "s", "ms", "MB"}
COLUMN_KEYS = {"s": "seconds", "truth's SCA": "truth_sca", "right in the camera, %": "right_in_camera"}
"""Keys of columns whose labels are unsuitable as keys."""


@dataclass(frozen=True)
class Column:
    """A column: key, label, unit."""

    key: str
    label: str
    unit: str = ""
    digits: int = 0
    """Decimals that pages show."""
    best: str = ""
    """"highest" or "lowest"; empty where rows are not compared by it."""


@dataclass(frozen=True)
class Table:
    """The measurements of one run."""

    title: str
    made: Mapping[str, str]
    """Date, commit, command, machine, versions, as far as known."""
    columns: Sequence[Column]
    rows: Sequence[Row]
    differences: Sequence[Row] = ()
    """Paired differences, each with the label of its baseline row, ``against``."""
    notes: Sequence[str] = field(default_factory=tuple)
    """Settings and explanations."""

    def column(self, key: str) -> Column:
        """Return a column by its key. Raises ``KeyError``."""
        return next((column for column in self.columns if column.key == key), None) or _missing(
            key, (column.key for column in self.columns)
        )

    def row(self, key: str, among: str = "rows") -> Row:
        """Return a row, or a difference, by the key of its label. Raises ``KeyError``."""
        rows: Sequence[Row] = getattr(self, among)
        return next((row for row in rows if key_of(row) == key), None) or _missing(key, map(key_of, rows))


def _missing(key: str, known: Iterable[str]) -> Any:
    raise KeyError(f"unknown key {key}; choose from {', '.join(known)}")


def slug(label: str, joint: str = "-") -> str:
    """Make a key from a label: "soft-hinge, 2.5 mm, 2°" is soft-hinge-2-5-mm-2."""
    return re.sub(r"[^a-z0-9]+", joint, label.lower()).strip(joint)


def key_of(row: Row) -> str:
    """Return a row's key."""
    return slug(str(row["label"]))


@cache
def read(name: str, folder: Path = RESULTS) -> Table:
    """Read a table. Raises ``KeyError`` for an unknown name."""
    path = folder / f"{name}.json"
    if not path.is_file():
        _missing(name, names(folder))
    record = json.loads(path.read_text(encoding="utf-8"))
    return Table(**{**record, "columns": [Column(**column) for column in record["columns"]]})


def names(folder: Path = RESULTS) -> list[str]:
    """Read all tables."""
    return sorted(path.stem for path in folder.glob("*.json"))


def write(name: str, table: Table, folder: Path = RESULTS) -> Path:
    """Write a table, each row on a line of its own."""
    keys = [key_of(row) for row in table.rows]
    if len(set(keys)) < len(keys):
        raise ValueError(f"{name}: two rows have the same key: {', '.join(keys)}")
    columns = [{key: value for key, value in asdict(column).items() if value} for column in table.columns]
    record = {**vars(table), "columns": columns}
    parts = [f" {json.dumps(key)}: {_lines(value)}" for key, value in record.items() if value]
    path = folder / f"{name}.json"
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")
    read.cache_clear()
    return path


def write_clips(name: str, text: str, folder: Path = CLIPS) -> Path:
    """Write a table's numbers by clip, a CSV file, compressed; equal numbers give equal bytes."""
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.csv.gz"
    path.write_bytes(gzip.compress(text.encode(), mtime=0))
    return path


def read_clips(name: str, folder: Path = CLIPS) -> list[dict[str, str]]:
    """Read a table's numbers by clip: a line for each clip, method and setting. Raises ``KeyError`` if missing."""
    path = folder / f"{name}.csv.gz"
    if not path.is_file():
        raise KeyError(f"{name}: its numbers by clip were not kept")
    return [*csv.DictReader(gzip.decompress(path.read_bytes()).decode().splitlines())]


def _lines(value: Any) -> str:
    """Format JSON with a line for each entry of a list."""
    if isinstance(value, str | Mapping):
        return json.dumps(value, ensure_ascii=False)
    return "[\n" + ",\n".join(f"  {json.dumps(one, ensure_ascii=False)}" for one in value) + "\n ]"


def of_cells(title: str, header: Sequence[str], lines: Sequence[Sequence[str]], notes: Sequence[str] = ()) -> Table:
    """Make a table from printed texts; the first columns that distinguish all rows become their labels."""
    cells = [[MARKUP.sub("", cell).strip() for cell in line] for line in lines]
    parsed = [[cell(text) for text in line] for line in cells]
    labels = 1
    while labels < len(header) and all(isinstance(line[labels], str) for line in parsed) and _alike(cells, labels):
        labels += 1
    columns = [_column(name, [line[n] for line in cells]) for n, name in enumerate(header) if n >= labels]
    rows = [
        {"label": ", ".join(filter(None, texts[:labels]))}
        | {column.key: value for column, value in zip(columns, values[labels:], strict=True) if value is not None}
        for texts, values in zip(cells, parsed, strict=True)
    ]
    return Table(title, {}, columns, rows, notes=tuple(notes))


def _column(heading: str, cells: Sequence[str]) -> Column:
    """Make the column of a heading, whose last words may be its unit."""
    label, _, unit = heading.rpartition(", ")
    if not label or unit not in UNITS:
        label, unit = heading, ""
    key = COLUMN_KEYS.get(heading) or slug(heading, "_")
    return Column(key, label, unit, digits=max(map(_digits, cells), default=0))


def _alike(cells: Sequence[Sequence[str]], labels: int) -> bool:
    """Return whether more columns are needed to distinguish rows."""
    return len({tuple(line[:labels]) for line in cells}) < len(cells)


def _digits(text: str) -> int:
    """Count the decimals of the number at the start of a text."""
    found = NUMBER.match(text)
    return len(found[1]) - 1 if found and found[1] else 0


def cell(text: str) -> Cell:
    """Parse a cell of a printed table: "98.6 [96, 100] (n = 71)", "1,234", "–", or a text."""
    found = INTERVAL.fullmatch(text)
    if text in {"", "–"}:
        return None
    if not found or not all(part is None or NUMBER.fullmatch(part) for part in found.groups()):
        return text
    value, low, high, count = (None if part is None else number(part) for part in found.groups())
    if count is not None:
        return [value, low, high, count]
    return value if low is None else [value, low, high]


def number(text: str) -> float:
    """Parse a printed number."""
    plain = text.replace(",", "").replace("−", "-")
    return float(plain) if "." in plain else int(plain)
