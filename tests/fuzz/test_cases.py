"""What fuzzing has found once is read or refused for good; and what it looks for, it would find."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fuzz import __main__ as command
from fuzz import corpus
from fuzz.child import SHARED, Child, Reader
from fuzz.corpus import CASES, READERS, Seed
from getagrip.errors import InputError


@pytest.fixture(autouse=True)
def _cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(SHARED / "cache"))


@pytest.mark.parametrize("case", sorted(CASES.glob("*.json")), ids=lambda path: path.stem)
@pytest.mark.slow
def test_what_was_found_is_read_or_refused(case: Path, tmp_path: Path) -> None:
    name, changes = corpus.read(case)
    seed = Seed.write(name, tmp_path)
    found = seed.attempt(changes)
    seed.child.close()
    assert found is None, f"{found.what}\n{found.details}"


@pytest.mark.parametrize("name", READERS)
@pytest.mark.slow
def test_each_reader_has_a_turn(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of few cases, the same each time: it shows that ``make fuzz`` starts."""
    monkeypatch.setattr(corpus, "CASES", tmp_path)
    assert command.main(["--only", name, "--turns", "1", "--cases", "1", "--seed", "1"]) == 0, capsys.readouterr().out


def refuses(folder: Path) -> None:
    raise InputError(folder, "", "nothing", "something")


def raises(folder: Path) -> None:
    {}[folder]


def waits(folder: Path) -> None:
    time.sleep(60)


def takes_memory(folder: Path) -> None:
    np.ones(2**28)


def dies(folder: Path) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def writes_outside(folder: Path) -> None:
    (folder.parent / "x").write_text("")


def reads_outside(folder: Path) -> None:
    (folder / ".." / "outside" / "secret").read_text()


def says_two_lines(folder: Path) -> None:
    error = InputError(folder, "", "nothing", "something")
    error.args = ("a\nb",)
    raise error


def warns(folder: Path) -> None:
    np.array([1e308]) * 10


@pytest.mark.parametrize(
    ("read", "what"),
    [
        (refuses, None), (raises, "KeyError"), (waits, "not done after 0.3 s"), (takes_memory, "MemoryError"),
        (dies, "the process died"), (writes_outside, "outside"), (reads_outside, "outside"),
        (says_two_lines, "several lines"), (warns, "RuntimeWarning"),
    ],
)  # fmt: skip
def test_what_no_reader_may_do_is_seen(tmp_path: Path, read: Callable[[Path], None], what: str | None) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret").touch()
    child = Child(read, tmp_path / "in")
    found = child.attempt(seconds=0.3 if read is waits else 20.0)
    child.close()
    assert (found is None) == (what is None)
    assert found is None or what in found.what


@pytest.mark.slow
def test_a_planted_fault_is_found_made_small_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def read(folder: Path) -> None:
        path = folder / "a.json"
        if path.is_file() and len(path.read_bytes()) < 10:
            raise ZeroDivisionError

    whole = Reader(lambda folder: (folder / "a.json").write_text('{"a": [1, 2, 3], "b": "some text"}'), read)
    monkeypatch.setitem(READERS, "planted", whole)
    monkeypatch.setattr(corpus, "CASES", tmp_path / "cases")
    monkeypatch.setattr(command, "TURN", float("inf"))  # however busy the machine is
    monkeypatch.setattr(command, "SHRINKING", 1.0)
    assert command.main(["--turns", "1", "--only", "planted", "--seed", "3"]) == 1
    (kept,) = (tmp_path / "cases").glob("planted-*.json")
    assert "ZeroDivisionError" in capsys.readouterr().out
    name, changes = corpus.read(kept)
    assert name == "planted"
    assert all(isinstance(content, str) or len(content) < 10 for content in changes.values())


def test_mended_seeds_are_as_before(tmp_path: Path) -> None:
    seed = Seed.write("labels", tmp_path)
    for change in (b"{", "missing", "folder", "fifo", "link to itself"):
        assert seed.attempt({"labels.json": change}) is None
        assert (seed.folder / "labels.json").read_bytes() == seed.files["labels.json"]
    seed.child.close()
