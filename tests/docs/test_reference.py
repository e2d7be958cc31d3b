"""What the site generates: a section for every command and every public name."""

from __future__ import annotations

import re
import runpy
from typing import Any

import pytest

import getagrip
from helpers.environment import ROOT, Run
from helpers.pages import PAGES


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "scripts" / "reference.py"))


@pytest.mark.slow
def test_every_command_is_in_it(reference: dict[str, Any], run: Run) -> None:
    listed = re.findall(r"^  (\w[\w-]*(?: [\w-]+)?)  ", run("--help")[1], re.MULTILINE)
    names = list(reference["commands"]())
    assert listed == [name for name in names if name.split()[0] not in {"import", "figure", "bench"} or " " not in name]
    assert {"import hands", "import hot3d", "figure gallery"} <= set(names)
    assert reference["help_of"]("clip new").startswith("usage: getagrip clip new ")


def test_every_public_name_is_in_it(reference: dict[str, Any]) -> None:
    headings = re.findall(r"^### (.*)", reference["public_names"](), re.MULTILINE)
    assert sorted(headings) == sorted(name for name in getagrip.__all__ if not name.startswith("__"))


def test_pages_have_a_place_for_it(reference: dict[str, Any]) -> None:
    holders = {page.stem for page in PAGES if reference["MARKER"] in page.read_text(encoding="utf-8")}
    assert holders == set(reference["GENERATED"])
