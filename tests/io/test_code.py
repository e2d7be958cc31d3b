"""The fingerprint of the code covers all that a reconstruction may import, and no more parts than that."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from getagrip.experiments import segment_trials, timeline_trials, trials
from getagrip.fitting.methods import METHODS
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.io import code
from helpers.paths import ROOT


def test_parts_that_are_left_out_are_those_above_the_fit() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [re.findall(r"\w+", layer) for layer in contracts[0]["layers"]]
    (fit,) = (n for n, layer in enumerate(layers) if "fitting" in layer)
    above = {part for layer in layers[:fit] for part in layer}
    beside = {part for part in layers[fit] if part != "fitting"}  # parts in one layer may not import each other
    assert {*code.ABOVE} == (above | beside) - {"timelines"}
    used = {
        part
        for path in (ROOT / "src/getagrip/timelines").rglob("*.py")
        for part in re.findall(r"(?:from|import) getagrip\.(\w+)", path.read_text("utf-8"))
    }
    assert "fitting" in used
    assert not used & {*code.ABOVE}
    assert re.fullmatch("[0-9a-f]{16}", code.fingerprint())


def test_what_is_made_otherwise_has_a_fingerprint_of_more_files() -> None:
    """Of changed clips, other systems, segments and timelines: of files that are there, and each of them counts."""
    parts = (*trials.CHANGES, *trials.SYSTEMS, *segment_trials.CODE, *timeline_trials.CODE)
    assert all((code.PACKAGE / part).exists() for part in parts)
    assert len({code.fingerprint(), *map(code.fingerprint, parts)}) == len({*parts}) + 1
    assert code.fingerprint("evaluation", "segmentation") == code.fingerprint("segmentation", "evaluation")


def loaded(file: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A user's file as a module."""
    monkeypatch.syspath_prepend(str(file.parent))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    sys.modules.pop(file.stem, None)
    importlib.invalidate_caches()
    return importlib.import_module(file.stem)


def test_code_from_outside_is_known_by_the_files_that_it_is_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    term, method = tmp_path / "own_term.py", tmp_path / "own_method.py"
    method.write_text("import numpy\nfrom own_term import weight\n\ndef fit(problem, on_stage):\n    return weight()\n")
    seen = set()
    for content in ("def weight(): return 1.0\n", "def weight(): return 1e7\n"):
        term.write_text(content)
        loaded(term, monkeypatch)
        fit = loaded(method, monkeypatch).fit
        assert code.outside(fit) == code.outside(partial(soft_hinge, more=fit))
        seen.add(code.outside(fit))
    assert len(seen - {"", None}) == 2


def test_code_of_the_package_is_not_from_outside_and_typed_code_is_in_no_file() -> None:
    assert {code.outside(method.fit) for method in METHODS.values()} == {""}
    typed: dict[str, Any] = {"__name__": "typed"}
    monkey = ModuleType("typed")
    sys.modules["typed"] = monkey
    try:
        exec("def fit(problem, on_stage): pass", typed)
        assert code.outside(typed["fit"]) is None
    finally:
        del sys.modules["typed"]
