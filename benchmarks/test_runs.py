"""Every run of the test objects: ``results/test-runs.json``, which pages print; ``python -m benchmarks.test_runs``.

``benchmarks.release`` and ``benchmarks.again`` note a run before it starts, whatever comes of it, and so does
``benchmarks.probability``; ``benchmarks.results`` takes no table of these objects that is not noted. The command puts
the runs before there was such a list in front: the tables' versions in git, each with when it first came in, and by
which code it was made.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime

from benchmarks import store
from benchmarks.release import BENCHES
from benchmarks.store import Column, Row, Table
from getagrip.io.plugins import date_and_commit

NAME, FOLDER = "test-runs", store.RESULTS
OBJECTS = "OTHER"
"""Placeholder in a command for the folder of the test objects."""
COMMAND = "python -m benchmarks.test_runs"
COLUMNS = (Column("table", "table"), Column("commit", "commit"), Column("run", "run"))
TITLE = "Every run of the test objects"


def tables() -> list[str]:
    """Name a release's tables of test objects."""
    return [name for name, command in BENCHES.items() if OBJECTS in command.split()]


def note(table: str, command: str) -> None:
    """Add a run that starts now to the list. ``command`` is printed on pages, so without private paths."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")
    row = {"label": f"{now}, {table}", "table": table, "commit": commit(), "run": command}
    found = _read()
    store.write(NAME, replace(found, rows=[*found.rows, row]), FOLDER)


def noted(table: str, commit: str) -> bool:
    """Return whether the list has a run of a table by the code of a commit."""
    of = [str(row["commit"]).split()[0] for row in _read().rows if row["table"] == table]
    return any(one.startswith(commit) or commit.startswith(one) for one in of)


def commit() -> str:
    """Return the commit of the package's code."""
    return date_and_commit().partition(", commit ")[2] or "unknown"


def _read() -> Table:
    if NAME in store.names(FOLDER):
        return store.read(NAME, FOLDER)
    day, _, commit = date_and_commit().partition(", commit ")
    return Table(TITLE, {"date": day, "commit": commit, "command": COMMAND}, COLUMNS, [])


def from_git() -> Iterator[Row]:
    """Yield the runs whose tables are in git's history, the oldest first."""
    seen = set[tuple[str, str]]()
    log = ("log", "--reverse", "--format=%h %cI", "--", *(f"results/{name}.json" for name in tables()))
    for line in _git(*log).splitlines():
        commit, when = line.split()
        for name in tables():
            try:
                made = json.loads(_git("show", f"{commit}:results/{name}.json"))["made"]
            except subprocess.CalledProcessError:  # the file did not exist yet
                continue
            if (name, made["commit"]) in seen:
                continue
            seen.add((name, made["commit"]))
            day = datetime.fromisoformat(when).astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S")
            how = {"table": name, "commit": made["commit"], "run": made["command"]}
            yield {"label": f"{day}, {name}", **how}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=store.ROOT, capture_output=True, text=True, check=True).stdout


def main() -> None:
    """Put the runs of git's history before the noted runs."""
    found, before = _read(), [*from_git()]
    known = {(row["table"], str(row["commit"]).split()[0]) for row in found.rows}
    new = [row for row in before if (row["table"], row["commit"]) not in known]
    print(store.write(NAME, replace(found, rows=[*new, *found.rows]), FOLDER))


if __name__ == "__main__":
    main()
