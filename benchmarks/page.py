"""Pages of measurements: prose by hand, each section's numbers by machine between markers."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from getagrip.experiments.stamp import stamp

DOCS = Path(__file__).resolve().parents[1] / "docs"
NUMBER = re.compile(r"[0-9]+\.[0-9]")
LIBRARIES = ("numpy", "numba", "scipy", "deodr")


def write(name: str, text: str, file: str = "benchmarks.md") -> None:
    """Put a section's text between its markers. Raises ``ValueError`` where the page has no such markers."""
    path = DOCS / file
    start, end = f"<!-- {name}: measured -->", f"<!-- {name}: end -->"
    page = path.read_text(encoding="utf-8")
    if page.count(start) != 1 or page.count(end) != 1:
        raise ValueError(f"{path}: expected the markers {start} and {end} once each")
    before, rest = page.split(start)
    path.write_text(f"{before}{start}\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table: the first column to the left, numbers to the right."""
    rule = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *rows))


def section(file: str, name: str) -> str:
    """What stands between a section's markers. Raises ``ValueError`` where there is no such section."""
    parts = (DOCS / file).read_text(encoding="utf-8").split(f"<!-- {name}: measured -->")
    if len(parts) != 2:
        raise ValueError(f"{file}: expected a section {name}")
    return parts[1].split(f"<!-- {name}: end -->")[0]


def numbers(file: str, name: str, columns: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Some columns of the first table of a section, of all clips, by the rows' labels."""
    text = section(file, name)
    table = text[text.index("\n|") + 1 :].split("\n\n")[0]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    places = [lines[0].index(column) for column in columns]
    return {row[0]: tuple(float(NUMBER.findall(row[at])[0]) for at in places) for row in lines[2:]}


def circumstances() -> str:
    """One line that says when, where, with what and how undisturbed a measurement was made."""
    there = {dist.name: dist.version for dist in metadata.distributions()}
    versions = ", ".join(f"{name} {there[name]}" for name in LIBRARIES if name in there)
    load = os.getloadavg()[0]
    return (
        f"*{_processor()}, {os.cpu_count()} cores, load before the run {load:.1f}; one thread. "
        f"Python {platform.python_version()}, {versions}; getagrip, {stamp()}.*"
    )


def _processor() -> str:
    """The processor's name, as Linux reports it."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
