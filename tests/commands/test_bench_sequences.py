"""What the benchmarks of whole sequences share: their trials are tasks of the ledger."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from getagrip.batch.ledger import Ledger
from getagrip.batch.share import Share
from getagrip.commands.bench_sequences import Plan, scored
from getagrip.experiments.segment_trials import SequenceScores, SequenceTrial
from getagrip.experiments.sources import Sample
from getagrip.fitting.options import Options


@pytest.mark.parametrize(("fail_fast", "names"), [(False, ["a", "c"]), (True, ["c"])])
def test_a_failure_is_told_and_in_the_ledger(
    tmp_path: Path, capsys: pytest.CaptureFixture, fail_fast: bool, names: list[str]
) -> None:
    def run(trial: SequenceTrial) -> SequenceScores:
        return SequenceScores(trial.name, failure="no masks" if trial.name == "b" else "")

    source: Any = None
    share = Share(workers=1, fail_fast=fail_fast)
    plan = Plan(source, tmp_path, Options(), None, share, overwrite=False, json=None)
    trials = [SequenceTrial(Sample(name, tmp_path / name), "none", plan.options, tmp_path, False) for name in "cba"]
    assert [one.name for one in scored(run, SequenceScores, trials, plan, debug=False)] == names
    assert "failed: b: no masks" in capsys.readouterr().err
    with Ledger(tmp_path) as ledger:
        states = {entry.name: (entry.state, entry.why) for entry in ledger.entries()}
    assert states == {"b": ("failed", "no masks")} | dict.fromkeys(names, ("done", ""))
