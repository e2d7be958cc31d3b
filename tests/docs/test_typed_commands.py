"""Whatever messages, pages and examples tell the reader to type exists: commands, their options, extras."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

import pytest

from getagrip import cli
from getagrip.cli import datasets
from getagrip.cli.command import Command
from getagrip.cli.figure import Figures
from helpers.environment import ROOT

CALL = re.compile(
    r"(?:^|[\s`'\"(])getagrip ((?:[a-z][a-z0-9-]*)(?: [a-z][a-z-]*)?)((?:[^.;`\n]|\.(?=\w|\.))*)", re.MULTILINE
)
OPTION = re.compile(r"(?<![\w-])--([a-zK][a-z0-9-]*)")
EXTRAS = re.compile(r"(?:getagrip|\.)\[([\w,]+)\]")
PROSE = {"was", "reconstructs", "reads", "in", "of", "itself", "and", "than", "has"}
"""Words behind our name that are no commands."""
ANYWHERE = {"debug", "quiet", "help", "version"}


def leaves(choice: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """All commands by the words that are typed."""
    for name, one in cli._subcommands_by_name(choice).items():
        words = f"{before} {name}".strip()
        inner = cli._subcommands_by_name(one)
        yield from leaves(one, words) if inner else [(words, one.__origin__)]


def options(kind: Any) -> set[str]:
    """The options of a command, those of its parts included."""
    own = {field.name for field in fields(kind)}
    try:
        hints = get_type_hints(kind, include_extras=True)
    except NameError:  # of what is imported for types only
        return {name.replace("_", "-") for name in own}
    found: set[str] = set()
    for one in own & hints.keys():
        about = getattr(hints[one], "__metadata__", ())
        name = next(filter(None, (getattr(each, "name", None) for each in about)), one)
        aliases = {alias.lstrip("-") for each in about for alias in getattr(each, "aliases", None) or ()}
        found |= aliases.union({name.replace("_", "-")}, *(options(part) for part in parts(hints[one])))
    return found


def parts(hint: Any) -> list[Any]:
    """The dataclasses in a type."""
    return (
        [hint]
        if isinstance(hint, type) and is_dataclass(hint)
        else [part for each in get_args(hint) for part in parts(each)]
    )


@pytest.fixture(scope="module")
def known() -> dict[str, set[str] | None]:
    """The options of each command; None where they depend on what is imported, drawn or compared."""
    named: dict[str, set[str] | None] = {}
    for words, kind in leaves(cli.command_union(Command, Figures)):
        fixed = is_dataclass(kind) and not words.startswith(("bench", "figure", "import"))
        named[words] = options(kind) if fixed else None
    return named | {"import": None, "bench": None, "figure": None, "init": None, "clip": None, "epic": None}


def texts() -> Iterator[tuple[str, str]]:
    """Pages, and what the package's strings say; docstrings are for those who read code."""
    for path in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").rglob("*.ipynb")]):
        yield path.name, path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "src").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and "getagrip" in node.value:
                yield path.name, node.value
            elif isinstance(node, ast.JoinedStr):
                yield path.name, "".join(part.value if isinstance(part, ast.Constant) else "X" for part in node.values)


def test_commands_that_are_to_be_typed_exist_with_their_options(known: dict[str, set[str] | None]) -> None:
    wrong, seen = [], 0
    for where, text in texts():
        for words, rest in CALL.findall(text):
            command = next((name for name in (words, words.split()[0]) if name in known), None)
            if command is None and words.split()[0] in PROSE:
                continue
            if command is None:
                wrong.append(f"{where}: getagrip {words}")
                continue
            seen += 1
            allowed = known[command]
            unknown = set(OPTION.findall(rest)) - ANYWHERE - (allowed or set())
            if allowed is not None and unknown:
                wrong.append(f"{where}: getagrip {command} --{', --'.join(sorted(unknown))}")
    assert wrong == []
    assert seen > 100


def test_extras_that_are_to_be_installed_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    named = {name for _, text in texts() for extras in EXTRAS.findall(text) for name in extras.split(",")}
    assert named - {"extra"} <= set(project["optional-dependencies"])
    assert {"hands", "ray"} <= named
    assert datasets.DATASETS
