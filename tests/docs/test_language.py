"""One English: retired words of the glossary are used nowhere, and docstrings begin as those of the field do."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.pages import PAGES
from helpers.paths import ROOT

SOURCES = sorted((ROOT / "src").rglob("*.py"))
RETIRED = re.compile(
    r"\b(doubt(ed|ful|s)?|foret(ell|old)\w*|crews?|told|so many|so manieth|(put|puts|set|sets) right|left behind"
    r"|of (its|the object's) kind|(hands|masks|mesh) held)\b",
    re.IGNORECASE,
)
"""Prose: pages, docstrings and messages."""
NAMES = re.compile(r"(^|_)(doubt(ed|ful|s)?|foretold|crews?|told|ways|held|given)(_|$)", re.IGNORECASE)
"""Identifiers."""
KEPT = {"given_hands", "hands_held"}
"""A flag's name, and a key of ``clip.json``."""
ELLIPSES = re.compile(r"(Of|The same|Likewise|As|What|Whether|Where|How far)\b")
"""No docstring begins so: it would lean on the line above."""


def docstrings(tree: ast.Module) -> Iterator[tuple[ast.AST, str, int]]:
    """The docstrings of a module, its classes, functions and attributes: what they are of, text, line."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for n, child in enumerate(body):
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                yield (node if n == 0 else body[n - 1]), child.value.value, child.lineno


def texts(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value, node.lineno


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.stem not in {"glossary", "CHANGELOG"}], ids=lambda p: p.name
)
def test_pages_use_no_retired_word(page: Path) -> None:
    found = RETIRED.findall(page.read_text(encoding="utf-8"))
    assert [words[0] for words in found] == []


def test_docstrings_and_messages_use_no_retired_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {match[0]}"
        for path in SOURCES
        for text, line in texts(ast.parse(path.read_text(encoding="utf-8")))
        if (match := RETIRED.search(text))
    ]
    assert found == []


def test_identifiers_use_no_retired_word() -> None:
    found = set()
    for path in SOURCES:
        if NAMES.search(path.stem):
            found.add(path.name)
        for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            if token.type == tokenize.NAME and NAMES.search(token.string) and token.string not in KEPT:
                found.add(f"{path.relative_to(ROOT)}: {token.string}")
    assert sorted(found) == []


def test_no_docstring_is_an_ellipsis() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text[:40]}"
        for path in SOURCES
        for _, text, line in docstrings(ast.parse(path.read_text(encoding="utf-8")))
        if ELLIPSES.match(text)
    ]
    assert found == []


def test_classes_are_things() -> None:
    """A class begins with no word that a function begins with; those of commands are their help, which asks to do."""
    verbs, classes = set(), []
    for path in SOURCES:
        for node, text, line in docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            first = text.split()[0] if text.split() else ""
            if isinstance(node, ast.FunctionDef) and not node.decorator_list:
                verbs.add(first)
            elif isinstance(node, ast.ClassDef) and not {"commands", "datasets"} & set(path.parts):
                classes.append((first, f"{path.relative_to(ROOT)}:{line}: {text[:50]}"))
    assert [where for first, where in classes if first in verbs - {"The", "A", "An"}] == []


def test_every_retired_word_of_the_glossary_is_looked_for() -> None:
    _, table = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").split("## Retired words")
    words = [row.split("|")[1].strip() for row in table.strip().splitlines()[2:]]
    assert len(words) >= 8
    looked_for = [
        word for word in words if RETIRED.search(word) or NAMES.search(re.sub(r" \(.*", "", word).split(",")[0])
    ]
    assert looked_for == words
