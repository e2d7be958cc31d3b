"""A call that a library ends from within: what is done and left is said all the same."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from helpers.environment import import_path

CODE = """
import os, sys
from pathlib import Path
from getagrip.batch.ledger import LedgerEntry
from getagrip.batch.clusters import report_on_death
from getagrip.batch.ledger import Ledger
sys.argv = ["/usr/bin/getagrip", "reconstruct", "my clips", "--engine", "ray"]
with Ledger(Path({0!r})) as ledger:
    ledger.expect([f"c{{n}}" for n in range(5)], [])
    for name, state in (("c0", "done"), ("c1", "done"), ("c2", "failed"), ("c3", "open")):
        ledger.claim(name, "options", "code")
        if state != "open":
            ledger.end(LedgerEntry(name, state, options="options", code="code"))
    with report_on_death(ledger.path.parent, "clips"):
        {1}
"""


@pytest.mark.slow
def test_where_a_process_ends_at_once_another_says_what_is_left(tmp_path: Path) -> None:
    code = CODE.format(str(tmp_path), "os._exit(1)")
    done = subprocess.run([sys.executable, "-c", code], env=import_path(), capture_output=True, text=True, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("getagrip: Ray's cluster has died")
    assert "2 of 5 clips are done, 1 failed, 2 are left" in line
    assert line.endswith("this continues: getagrip reconstruct 'my clips' --engine ray")


@pytest.mark.slow
@pytest.mark.parametrize("end", ["pass", "raise SystemExit(3)"])
def test_where_it_ends_by_itself_nothing_is_said(tmp_path: Path, end: str) -> None:
    code = CODE.format(str(tmp_path), end)
    done = subprocess.run([sys.executable, "-c", code], env=import_path(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3 if end != "pass" else 0, "")
