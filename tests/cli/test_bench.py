"""Benchmarks of whole sequences: what fails is told, is in the ledger, and stops no other but on demand."""

from __future__ import annotations

from pathlib import Path

import pytest

from getagrip.batch.ledger import Ledger
from getagrip.batch.scheduling import SchedulingOptions
from getagrip.bench import sources
from getagrip.bench.sequences.segments import SegmentBenchmark, SequenceScores, SequenceTrial
from getagrip.bench.sequences.timelines import TimelineScores, TimelineTrial
from getagrip.bench.sources import Sample
from getagrip.bench.sources.recorded import DexYcbSequences, Hot3dTimelines
from getagrip.cli.bench import BenchSegments, BenchTimelines
from getagrip.errors import GetagripError, UsageError
from getagrip.readers.datasets.hot3d.hot3d_clips import Hot3d


def samples_are(monkeypatch: pytest.MonkeyPatch, folder: Path, *names: str) -> None:
    """These are the clips of any source."""
    found = [Sample(name, folder / name) for name in names]
    monkeypatch.setattr(sources, "sample_clips", lambda *_: (found, []))


@pytest.mark.parametrize(("fail_fast", "names"), [(False, ["a", "c"]), (True, ["c"])])
def test_a_failure_is_told_and_in_the_ledger(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    fail_fast: bool,
    names: list[str],
) -> None:
    shown = list[str]()

    def scores(trial: SequenceTrial) -> SequenceScores:
        if trial.name == "b":
            raise GetagripError("no masks")
        return SequenceScores(trial.name)

    def page(_: object, given: list[SequenceScores]) -> None:
        shown.extend(one.name for one in given if not one.failure)

    samples_are(monkeypatch, tmp_path, *"cba")
    monkeypatch.setattr(SequenceTrial, "scores", scores)
    monkeypatch.setattr(SegmentBenchmark, "page", page)
    share = SchedulingOptions(workers=1, fail_fast=fail_fast)
    assert BenchSegments(source=DexYcbSequences(), out=tmp_path, share=share).run() == 1
    assert shown == names
    assert "failed: b: no masks" in capsys.readouterr().err
    with Ledger(tmp_path) as ledger:
        states = {entry.name: (entry.state, entry.why) for entry in ledger.entries()}
    assert states == {"b": ("failed", "no masks")} | dict.fromkeys(names, ("done", ""))


def test_a_table_needs_timelines_that_lie_and_are_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = Hot3dTimelines(root=tmp_path, preset="strong")
    assert isinstance(source.reader(tmp_path), Hot3d)
    samples_are(monkeypatch, tmp_path, "P0001--a--mug")
    monkeypatch.setattr(TimelineTrial, "scores", lambda trial: TimelineScores(trial.name))
    with pytest.raises(UsageError, match="missing a timeline with both a static segment and a stable grasp"):
        BenchTimelines(source=source, out=tmp_path, share=SchedulingOptions(workers=1)).run()
