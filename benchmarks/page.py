"""Pages of measurements: prose by hand, each section's numbers by machine between markers.

No benchmark names a page: a section is on the one page that has its markers, of the README and of docs.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from getagrip.experiments.stamp import stamp

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
NUMBER = re.compile(r"[0-9]+\.[0-9]")
LIBRARIES = ("numpy", "numba", "scipy", "deodr")


def has(name: str) -> bool:
    """Whether a page has markers for a section."""
    return bool(_pages(name))


def write(name: str, text: str) -> None:
    """Put a section's text between its markers. Raises ``ValueError`` where not exactly one page has them."""
    path, before, _, after = _split(name)
    start, end = _markers(name)
    path.write_text(f"{before}{start}\n{text}\n{end}{after}", encoding="utf-8")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table: the first column to the left, numbers to the right."""
    rule = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *rows))


def section(name: str) -> str:
    """What stands between a section's markers. Raises ``ValueError`` where not exactly one page has them."""
    return _split(name)[2]


def numbers(name: str, columns: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Some columns of a section's first table that has them all, of all clips, by the rows' labels.

    NaN where a cell holds no number. There are no rows where there is no such table.
    """
    for text in section(name).split("\n\n"):
        lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.strip().splitlines()]
        if not {*columns} <= {*lines[0]}:
            continue
        places = [lines[0].index(column) for column in columns]
        return {row[0]: tuple(map(_number, (row[at] for at in places))) for row in lines[2:]}
    return {}


def _number(cell: str) -> float:
    """The first number of a cell."""
    return float((NUMBER.findall(cell) or ["nan"])[0])


def circumstances() -> str:
    """One line that says when, where, with what and how undisturbed a measurement was made."""
    there = {dist.name: dist.version for dist in metadata.distributions()}
    versions = ", ".join(f"{name} {there[name]}" for name in LIBRARIES if name in there)
    load = os.getloadavg()[0]
    return (
        f"*{_processor()}, {os.cpu_count()} cores, load before the run {load:.1f}; one thread. "
        f"Python {platform.python_version()}, {versions}; getagrip, {stamp()}.*"
    )


def _markers(name: str) -> tuple[str, str]:
    """What begins and ends a section."""
    return f"<!-- {name}: measured -->", f"<!-- {name}: end -->"


def _pages(name: str) -> list[Path]:
    """The pages on which a section begins."""
    pages = (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
    return [path for path in pages if _markers(name)[0] in path.read_text(encoding="utf-8")]


def _split(name: str) -> tuple[Path, str, str, str]:
    """A section's page, and what is before, between and after its markers."""
    start, end = _markers(name)
    pages = _pages(name)
    texts = [path.read_text(encoding="utf-8") for path in pages]
    if [(text.count(start), text.count(end)) for text in texts] != [(1, 1)]:
        found = ", ".join(path.name for path in pages) or "no page"
        raise ValueError(f"expected {start} and {end} once each on one page, found the first on {found}")
    before, rest = texts[0].split(start)
    between, after = rest.split(end)
    return pages[0], before, between, after


def _processor() -> str:
    """The processor's name, as Linux reports it."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
