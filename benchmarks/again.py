"""Measure a slice of a table again: ``python -m benchmarks.again TABLE [--clips N] [--out DIR] [WORD=DIR ...]``.

N of the table's clips, evenly spaced, are reconstructed by the command that its JSON names, into DIR, and every number
of them but the seconds is compared with ``results/clips/TABLE.csv.gz``. The words of the command that stand for folders
are given as to make: DEXYCB=DIR YCB=DIR. It says whether all are equal, and by how much each column differs; the exit
status is 1 unless they are, also where a table's numbers by clip were not kept.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks import store, test_runs
from benchmarks.results import CLIPS

KEY = ("clip", "method", "setting")
APART = ("seconds",)
"""Columns that differ in every run."""
CHOSEN = ("--clips", "--split", "--keep", "--only", "--out")
"""Options of a table's command that select clips or the folder; ``--keep`` changes no number of a clip."""
Line = dict[str, str]


def chosen(lines: Sequence[Line], clips: int) -> list[str]:
    """Return the names of some clips, evenly spaced."""
    names = [*dict.fromkeys(line["clip"] for line in lines)]
    return [names[n] for n in np.unique(np.linspace(0, len(names) - 1, min(clips, len(names))).round().astype(int))]


def command(table: str, only: Path, out: Path, folders: dict[str, str]) -> list[str]:
    """Return the words of a table's command, for the clips of a file. Raises ``KeyError`` for a missing folder."""
    words, kept = shlex.split(store.read(table).made["command"]), list[str]()
    if words[:2] != ["getagrip", "bench"]:
        raise KeyError(f"{table}: made by {shlex.join(words)}, which makes no slices")
    for n, word in enumerate(words):
        if word in CHOSEN or words[n - 1] in CHOSEN:
            continue
        if re.fullmatch(r"[A-Z][A-Z0-9_]+", word) and word not in folders:
            raise KeyError(f"missing {word}=DIR: {shlex.join(words)}")
        kept.append(folders.get(word, word))
    return [*kept[1:], "--only", str(only), "--out", str(out)]


def differences(before: Sequence[Line], after: Sequence[Line]) -> Iterator[tuple[str, float]]:
    """Yield each column that differs, and by how much at most: relative to the larger, infinite where it is no number.

    A line that is in one of them only differs in "line".
    """
    old, new = ({tuple(line[key] for key in KEY): line for line in lines} for lines in (before, after))
    if old.keys() != new.keys():
        yield "line", math.inf
    largest = dict[str, float]()
    for key in old.keys() & new.keys():
        for column in old[key].keys() | new[key].keys():
            one, other = (lines[key].get(column) or "" for lines in (old, new))
            if one != other and column not in APART:
                largest[column] = max(largest.get(column, 0.0), _apart(one, other))
    yield from largest.items()


def _apart(one: str, other: str) -> float:
    try:
        a, b = float(one), float(other)
    except ValueError:
        return math.inf
    return abs(a - b) / max(abs(a), abs(b))


def main(words: Sequence[str]) -> int:
    """Measure the slice and compare it; returns 1 unless all numbers are equal."""
    parser = argparse.ArgumentParser("python -m benchmarks.again", description="Make a slice of a table again.")
    parser.add_argument("table", choices=store.names(), metavar="TABLE", help="a table of results/")
    parser.add_argument("folders", nargs="*", metavar="WORD=DIR", help="folders that its command names")
    parser.add_argument("--clips", type=int, metavar="N", default=3, help="number of clips (default: 3)")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/again"), help="default: out/again")
    asked = parser.parse_args(words)
    out: Path = asked.out / asked.table
    try:
        kept = store.read_clips(asked.table)
        names = chosen(kept, asked.clips)
        only = out.with_name(f"{asked.table}.txt")
        call = command(asked.table, only, out, dict(each.split("=", 1) for each in asked.folders if "=" in each))
    except KeyError as error:
        print(error.args[0], file=sys.stderr)
        return 1
    only.parent.mkdir(parents=True, exist_ok=True)
    only.write_text("\n".join(names) + "\n", encoding="utf-8")
    if asked.table in test_runs.tables():
        test_runs.note(asked.table, f"python -m benchmarks.again {asked.table} --clips {asked.clips}")
    print(f"getagrip {shlex.join(call)}", flush=True)
    status = subprocess.run([sys.executable, "-m", "getagrip", *call], check=False).returncode
    made = out / f"{asked.table.removeprefix(f'{_folder(asked.table)}-')}{CLIPS}.csv"
    if status or not made.exists():
        print(f"{asked.table}: the bench failed (exit status {status})", file=sys.stderr)
        return 1
    before = [line for line in kept if line["clip"] in names]
    found = dict(differences(before, [*csv.DictReader(made.read_text(encoding="utf-8").splitlines())]))
    how = store.read(asked.table).made
    print(
        f"{asked.table}, clips: {len(names)}, results: {len(before)}, of {how.get('commit', 'an unknown commit')}:",
        end=" ",
    )
    print("equal" if not found else "not equal")
    for column, most in sorted(found.items(), key=lambda each: -each[1]):
        print(f"  {column}: {'another text' if math.isinf(most) else f'by {100.0 * most:.2g} %'}")
    return int(bool(found))


def _folder(table: str) -> str:
    """Return the name of the output folder of a table's command."""
    words = shlex.split(store.read(table).made["command"])
    return Path(words[words.index("--out") + 1]).name


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
