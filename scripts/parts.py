"""Write the table of parts into docs/architecture.md, from the linter's layers and each room's docstring.

``python scripts/parts.py``; a test holds that the page is up to date.
"""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
PACKAGE = ROOT / "src" / "getagrip"
START, END = "<!-- parts: generated -->\n", "<!-- parts: end -->"


def table() -> str:
    """Return the parts, lowest first: a row for each layer."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rows = ["| part | what it is for |", "|---|---|"]
    for layer in reversed(layers):
        for part in layer.replace("|", " ").replace(":", " ").replace("(", " ").replace(")", " ").split():
            rows.append(f"| `{part}{'/' if (PACKAGE / part).is_dir() else ''}` | {_summary(part)} |")
    return "\n".join(rows) + "\n"


def page() -> str:
    """Return the page with an up-to-date table."""
    before, rest = PAGE.read_text(encoding="utf-8").split(START)
    return f"{before}{START}{table()}{END}{rest.split(END)[1]}"


def _summary(part: str) -> str:
    """Return the first paragraph of a module's or a package's docstring."""
    path = PACKAGE / part / "__init__.py" if (PACKAGE / part).is_dir() else PACKAGE / f"{part}.py"
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split()).replace("``", "`")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
