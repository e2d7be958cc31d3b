"""Kernels are compiled by one process of a machine, and by no other one then."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from pathlib import Path

import pytest

from getagrip.batch import compiled
from getagrip.io import locks
from getagrip.kernels.silhouette import silhouettes
from helpers.paths import ROOT


@pytest.fixture
def marked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where the mark is, in a folder that is not there yet."""
    mark = tmp_path / "cache" / "mark.nbi"
    monkeypatch.setattr(compiled, "mark_file", lambda: mark)
    return mark


@pytest.fixture
def compiling(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], None]:
    """Have something else done in place of the small reconstruction."""
    return lambda instead: monkeypatch.setattr(compiled, "reconstruct_small", instead)


@pytest.mark.skipif(not locks.KNOWN, reason="no locks here")
def test_of_several_at_once_one_compiles_and_the_others_wait(marked: Path, compiling: Callable[..., None]) -> None:
    ended: list[float] = []

    def slowly() -> None:
        time.sleep(0.05)
        ended.append(time.monotonic())

    compiling(slowly)
    with ThreadPoolExecutor(4) as threads:
        returned = [*threads.map(lambda _: (compiled.compile_once(), time.monotonic())[1], range(4))]
    assert len(ended) == 1
    assert min(returned) >= ended[0]
    compiled.compile_once()
    assert len(ended) == 1


def test_it_is_done_again_for_other_code_and_where_the_mark_is_gone(
    marked: Path, compiling: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[None] = []
    compiling(lambda: done.append(None))
    compiled.compile_once()
    monkeypatch.setattr("getagrip.io.code.fingerprint", lambda: "0" * 16)
    compiled.compile_once()
    assert len(done) == 2
    marked.unlink()
    compiled.compile_once()
    compiled.compile_once()
    assert len(done) == 3


def test_a_failure_is_left_to_the_clips(marked: Path, compiling: Callable[..., None]) -> None:
    tries: list[None] = []

    def fail() -> None:
        tries.append(None)
        raise OSError("no space left")

    compiling(fail)
    compiled.compile_once()
    compiled.compile_once()
    assert len(tries) == 2


def test_the_mark_goes_when_the_kernels_are_removed() -> None:
    mark = compiled.mark_file()
    assert mark.parent == Path(silhouettes.stats.cache_path)
    removed = "*.nb[ci]"
    assert removed in (ROOT / "Makefile").read_text("utf-8")
    assert fnmatch(mark.name, removed)
