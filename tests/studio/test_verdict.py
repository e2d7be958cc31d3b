"""The verdict on a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from getagrip.result import write_result
from getagrip.result.findings import ASSUMED_MESH, Finding, Probability, Verdict
from getagrip.studio.shown_result import describe_result
from helpers.clips import small_clip
from helpers.results import true_result

RESULT = replace(true_result(small_clip()[0], None), findings=(), probability_right=None)
SERIOUS, NOTE = (Finding("hand-size", worse, 1.0, 0.5, f"serious: {worse}") for worse in (True, False))


@pytest.mark.parametrize(
    ("value", "beyond", "word"),
    [
        (0.95, (), "right"), (0.5, (), "uncertain"), (0.1, (), "wrong"),
        (0.05, (ASSUMED_MESH,), "right"), (0.005, (ASSUMED_MESH,), "wrong"),
    ],
)  # fmt: skip
def test_a_verdict_follows_the_probability_unless_a_finding_is_serious(
    value: float, beyond: tuple[str, ...], word: Verdict
) -> None:
    result = replace(RESULT, probability_right=Probability(value, "", beyond), findings=(NOTE,))
    assert result.verdict == word
    assert replace(result, findings=(NOTE, SERIOUS)).verdict == "wrong"
    assert replace(result, probability_right=None).verdict == "uncertain"
    for seen, looks in ((0.9, "right"), (0.6, "uncertain"), (0.3, "wrong")):  # of a draft, whatever its distance
        assert replace(result, probability_looks_right=Probability(seen, "")).verdict == looks


def test_serious_findings_come_first_and_what_does_not_read_is_uncertain(tmp_path: Path) -> None:
    folder = write_result(replace(RESULT, findings=(NOTE, SERIOUS)), tmp_path / "it", "", {}, tmp_path)
    found = describe_result(folder)
    steps = [{"do": "size"}]
    assert found["findings"] == [
        {"serious": True, "message": "serious: True", "steps": steps},
        {"serious": False, "message": "serious: False", "steps": steps},
    ]
    (folder / "result.npz").write_bytes(b"PK nothing")
    assert describe_result(folder)["verdict"] == "uncertain"


def test_the_probability_of_a_draft_leaves_its_distance_out(tmp_path: Path) -> None:
    plain = replace(RESULT, probability_right=Probability(0.1, ""))
    draft = replace(plain, probability_looks_right=Probability(0.9, ""))
    said = [
        describe_result(write_result(one, tmp_path / name, "", {}, tmp_path))["probability"]
        for name, one in (("plain", plain), ("draft", draft))
    ]
    assert said == ["10 % that it is right", "90 % that it is right but for its distance"]
