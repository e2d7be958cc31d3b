"""The walk through the code (docs/reading.md): whatever it names is where it says."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec

import pytest

from helpers.environment import ROOT

PAGE = (ROOT / "docs" / "reading.md").read_text(encoding="utf-8")
NAMES = sorted({name for name in re.findall(r"`((?:\w+\.)+\w+)`", PAGE) if not name.endswith((".py", ".json"))})


@pytest.mark.parametrize("name", NAMES)
def test_each_name_is_a_module_or_in_one(name: str) -> None:
    module, _, inner = f"getagrip.{name.removeprefix('getagrip.')}".rpartition(".")
    assert hasattr(import_module(module), inner) or find_spec(f"{module}.{inner}")


def test_it_can_be_read_in_an_hour() -> None:
    assert 60 <= len(PAGE.splitlines()) <= 100
    assert len(NAMES) > 60
