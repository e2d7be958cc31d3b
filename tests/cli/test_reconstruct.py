"""`reconstruct --find-grasps`: what was found is kept, shared between calls, and found within limits."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.batch import clips as batch_clips
from getagrip.cli.reconstruct import Reconstruct
from getagrip.clip import write_clip
from getagrip.timelines.detect import detect_segments
from getagrip.timelines.detect.detect_segments import DetectedSegments
from helpers.environment import Run
from helpers.scenes import from_table

NAMES = ("a", "b", "c")


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """A folder of clips in which an object lies still."""
    clip, masks = from_table()
    clip = replace(clip.take(np.arange(12)), world=None, truth=None)
    for name in NAMES:
        write_clip(replace(clip, name=name), masks.take(np.zeros(12, dtype=int)), tmp_path / "clips" / name)
    return tmp_path / "clips"


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The clips that were searched, as they were begun."""
    names: list[str] = []
    find = detect_segments.find_segments

    def noting(clip: Any, *args: Any, **kwargs: Any) -> DetectedSegments:
        names.append(clip.name)
        return find(clip, *args, **kwargs)

    monkeypatch.setattr(detect_segments, "find_segments", noting)
    return names


@pytest.fixture
def reconstructed(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[Path]]:
    """What each call wants to have reconstructed; nothing is."""
    wanted: list[Sequence[Path]] = []

    def note(paths: Sequence[Path], *_: object) -> int:
        wanted.append(paths)
        return 0

    monkeypatch.setattr(batch_clips, "reconstruct_clips", note)
    return wanted


@pytest.mark.slow
def test_what_was_found_is_found_again_only_where_something_differs_and_that_is_said(
    tmp_path: Path, clips: Path, run: Run, searched: list[str], reconstructed: list[Sequence[Path]]
) -> None:
    out = tmp_path / "out"
    made, record = out / "clips" / "a", out / "clips" / "a.timeline.json"

    def said(*options: object) -> str:
        status, printed, _ = run("reconstruct", "--find-grasps", clips / "a", "--out", out, *options)
        assert status == 0
        return str(printed)

    assert said().startswith("a: no stable grasp; the camera is taken to stand still: a guess\n")
    assert "; found before\n" in said("--overwrite")
    assert "; found before\n" in said("--sampled-only")
    assert searched == ["a"]
    assert reconstructed == [[made]] * 3
    changes: list[tuple[str, Callable[[], object], list[object]]] = [
        ("the earlier result is of other options", lambda: None, ["--inits", 6]),
        ("the earlier result is of other options", lambda: None, []),
        ("the earlier result has been changed", lambda: _rewrite(made / "clip.json"), []),
        ("the earlier result is damaged", (made / "hand.npz").unlink, []),
        ("the earlier result is damaged", lambda: record.write_text("[]"), []),
        ("the earlier result is damaged", lambda: _rewrite(record, clips=3), []),
        ("the earlier result is of other code", lambda: _rewrite(record, code="0"), []),
        ("the earlier result is of another clip", lambda: _rewrite(clips / "a" / "clip.json"), []),
    ]
    for why, change, options in changes:
        change()
        assert f"; found again, since {why}" in said(*options), why
    assert len(searched) == 1 + len(changes)
    assert "; found before\n" in said()


def _rewrite(path: Path, **fields: object) -> None:
    """Change fields of a JSON file, and where its lines end."""
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


def test_a_clip_without_a_grasp_is_searched_once(tmp_path: Path, clips: Path, run: Run, searched: list[str]) -> None:
    for _ in range(2):
        status, printed, _ = run("reconstruct", "--cut-grasps", clips, "--out", tmp_path / "out")
        assert (status, printed.count("no stable grasp")) == (0, 3)
    assert searched == [*NAMES]
    assert printed.count("; found before\n") == 3


@pytest.mark.slow
def test_two_calls_at_once_search_each_clip_once_and_both_have_them_all(
    tmp_path: Path, clips: Path, monkeypatch: pytest.MonkeyPatch, searched: list[str],
    reconstructed: list[Sequence[Path]],
) -> None:  # fmt: skip
    find = detect_segments.find_segments

    def slowly(*args: Any, **kwargs: Any) -> DetectedSegments:
        time.sleep(0.1)
        return find(*args, **kwargs)

    monkeypatch.setattr(detect_segments, "find_segments", slowly)

    def call(_: int) -> int:
        return Reconstruct(clips=(clips,), out=tmp_path / "out", find_grasps=True).run()

    with ThreadPoolExecutor(2) as threads:
        assert [*threads.map(call, range(2))] == [0, 0]
    assert sorted(searched) == [*NAMES]
    assert reconstructed == [[tmp_path / "out" / "clips" / name for name in NAMES]] * 2


@pytest.mark.slow
def test_nothing_is_begun_once_a_clip_has_failed(
    tmp_path: Path, clips: Path, run: Run, searched: list[str], reconstructed: list[Sequence[Path]]
) -> None:
    next((clips / "b" / "masks" / "object").glob("*.png")).write_bytes(b"no image")
    call = ("reconstruct", "--find-grasps", clips, "--out", tmp_path / "out", "--ledger", tmp_path / "ledger")
    status, _, err = run(*call, "--fail-fast")
    assert (status, "--fail-fast: the other clips are skipped" in err) == (1, True)
    assert (searched, reconstructed) == (["a"], [])
    assert run(*call)[0] == 1
    assert (searched, len(reconstructed[0])) == (["a", "c"], 2)
    assert _states(tmp_path / "ledger") == {"a": "done", "b": "failed", "c": "done"}
    assert not (tmp_path / "out" / "clips" / "ledger.sqlite").exists()


def _states(ledger: Path) -> dict[str, str]:
    """What the ledger says of each clip."""
    with closing(sqlite3.connect(ledger / "clips" / "ledger.sqlite")) as db:
        return dict(db.execute("SELECT name, state FROM tasks"))


def test_a_shard_has_its_part_of_the_clips(
    tmp_path: Path, clips: Path, run: Run, searched: list[str], reconstructed: list[Sequence[Path]]
) -> None:
    for shard in ("1/2", "2/2"):
        assert run("reconstruct", "--find-grasps", clips, "--out", tmp_path / "out", "--shard", shard)[0] == 0
    assert sorted(searched) == [*NAMES]
    assert sum(map(len, reconstructed)) == 3


@pytest.mark.slow
def test_a_clip_that_takes_too_long_to_search_is_left_behind(tmp_path: Path, clips: Path, run: Run) -> None:
    limit = ("--limit-seconds", 0.001, "--workers", 1)
    status, _, err = run("reconstruct", "--find-grasps", clips / "a", "--out", tmp_path / "out", *limit)
    assert (status, err) == (1, "failed: a: it took longer than 0.001 s (--limit-seconds)\n")
