"""The checksum of code from outside the package: it changes with all that a function is made of, and else not."""

from __future__ import annotations

import sys
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.fitting.energy import mask as package_module
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.io.source_checksum import UnknownSourceError, source_checksum

MINE = """
from dataclasses import dataclass
import numpy as np
import of_all
from .beside import WIDTH

@dataclass(frozen=True)
class Term:
    weight: float = 1.0
    def __call__(self): return WIDTH

def fit(problem, on_stage):
    from later import late
    return of_all, late

def made(weight):
    def inner(problem, on_stage): return weight
    return inner
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that loads a package of a user's as it is on disk; its files lie in ``tmp_path``."""
    (tmp_path / "of_user").mkdir()
    files = {"of_user/__init__.py": "", "of_user/mine.py": MINE, "of_user/beside.py": "WIDTH = 1\n"}
    for name, text in (files | {"of_all.py": "from of_user import beside\n", "later.py": "late = 1\n"}).items():
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def load() -> Any:
        for name in [name for name in sys.modules if name.split(".")[0] in ("of_user", "of_all", "later")]:
            del sys.modules[name]
        from importlib import import_module, invalidate_caches

        invalidate_caches()
        return import_module("of_user.mine")

    return load


@pytest.mark.parametrize("file", ["of_user/mine.py", "of_user/beside.py", "of_all.py", "later.py"])
def test_it_changes_with_each_file_that_a_function_uses(mine: Any, tmp_path: Path, file: str) -> None:
    before = source_checksum(mine().fit)
    assert source_checksum(mine().fit) == before
    changed = tmp_path / file
    changed.write_text(changed.read_text() + "# another\n")
    assert source_checksum(mine().fit) != before


@pytest.mark.parametrize(
    "made",
    [
        lambda of: of.fit,
        lambda of: partial(of.fit, more=1.0),
        lambda of: partial(soft_hinge, more=of.fit),
        lambda of: of.made(of.Term()),
        lambda of: of.Term(),
        lambda of: of.Term().__call__,
        lambda of: lru_cache(of.fit),
        lambda of: {"terms": (of.Term,)},
    ],
)
def test_it_finds_the_file_wherever_its_code_is(mine: Any, tmp_path: Path, made: Any) -> None:
    before = source_checksum(made(mine()))
    assert source_checksum(made(mine())) == before
    (tmp_path / "of_user" / "mine.py").write_text(MINE.replace("weight: float = 1.0", "weight: float = 1.00"))
    assert source_checksum(made(mine())) != before


@pytest.mark.parametrize(
    ("one", "other"),
    [(1.0, 2.0), (np.zeros(2000), np.eye(1, 2000, 1000)[0]), ({1, 2}, {1, 3}), ((1, (2,)), (1, (3,))), (None, False)],
)
def test_values_in_partials_and_closures_count(mine: Any, one: Any, other: Any) -> None:
    of = mine()
    assert source_checksum(partial(of.fit, more=one)) == source_checksum(partial(of.fit, more=one))
    assert source_checksum(partial(of.fit, more=one)) != source_checksum(partial(of.fit, more=other))
    assert source_checksum(of.made(one)) != source_checksum(of.made(other))


def test_sources_that_are_in_no_file_are_unknown() -> None:
    there: dict[str, Any] = {}
    exec(compile("def fit(problem, on_stage): return 1\nmade = lambda: 1", "<stdin>", "exec"), there)
    for unknown in (there["fit"], partial(soft_hinge, more=there["made"]), np.random.default_rng(0), iter("a")):
        with pytest.raises(UnknownSourceError):
            source_checksum(unknown)


def test_of_the_package_only_names_count() -> None:
    assert source_checksum(soft_hinge) == source_checksum(soft_hinge)
    assert source_checksum(soft_hinge) != source_checksum(package_module)
