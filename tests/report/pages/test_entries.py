"""What paths stand for, and in which order it is listed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli.report import find_results_and_clips
from getagrip.clip import input_sha256, write_clip
from getagrip.report.pages.viewer import GROUND_TRUTH_LABEL, entry_severity_key, group_entries, label_views
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import Finding
from helpers.environment import Run
from helpers.results import two_candidates, view

SERIOUS = Finding("contact-gap", True, 40.0, 15.0, "they are far apart")


def never(error: Exception) -> None:
    raise error


def result(iou: float, *findings: Finding) -> Reconstruction:
    made = two_candidates()[0]
    return replace(made, iou=np.full(len(made.frames), iou), findings=findings)


@pytest.fixture(scope="module")
def root(tmp_path_factory: Any) -> Path:
    """Two clips; results of two methods for the one, of one method for the other; nothing is changed by tests."""
    made: Path = tmp_path_factory.mktemp("entries")
    _, clip, masks = two_candidates()
    for name, iou, methods in (("good", 0.9, ("one-dof", "static")), ("bad", 0.4, ("one-dof",))):
        folder = write_clip(replace(clip, name=name), masks, made / "clips" / name)
        for method in methods:
            one = replace(result(iou), clip=name, method=method)
            write_result(one, made / "results" / method / name, input_sha256(folder), clip_folder=folder)
    return made


def test_serious_findings_come_first_and_then_the_lowest_iou() -> None:
    given = {"fine": result(0.9), "poor": result(0.3), "flagged": result(0.95, SERIOUS)}
    assert sorted(given, key=lambda name: entry_severity_key([given[name]])) == ["flagged", "poor", "fine"]


@pytest.mark.slow
def test_a_folder_of_methods_is_listed_by_clip_the_worst_first(root: Path) -> None:
    problems: list[Exception] = []
    results, clips = find_results_and_clips([root / "results"], problems)
    assert (len(results), clips, problems) == (3, [], [])
    bad, good = group_entries(results, clips, None, never)
    assert bad.label == "bad, IOU 40 %"
    assert good.label == "good, IOU 90 %, 2 results"
    assert [column.label for column in good.read()] == ["1-DoF, ours", "Static"]
    assert good.read()[0].view.clip.name == "good"


def test_results_and_clips_may_be_named_in_any_way(root: Path) -> None:
    problems: list[Exception] = []
    results, clips = find_results_and_clips(
        [root / "results" / "one-dof", root / "results" / "static" / "good"], problems
    )
    assert [entry.label for entry in group_entries(results, clips, None, never)] == [
        "bad, IOU 40 %",
        "good, IOU 90 %, 2 results",
    ]
    results, clips = find_results_and_clips([root / "clips"], problems)
    assert results == []
    assert [entry.read()[0].label for entry in group_entries(results, clips, None, never)] == [
        GROUND_TRUTH_LABEL,
        GROUND_TRUTH_LABEL,
    ]
    assert find_results_and_clips([root / "clips" / "bad"], problems)[1] == [root / "clips" / "bad"]
    assert problems == []
    find_results_and_clips([root / "clips" / "bad" / "masks", root / "nowhere"], problems)
    assert ["no such folder" in str(problem) for problem in problems] == [False, True]


def test_results_of_one_method_are_told_apart_by_their_folders() -> None:
    one = view()
    static = replace(one, result=replace(one.result, method="static"))
    method = "1-DoF, ours"
    assert label_views([one, one, static], ["a", "b", "c"]) == [f"{method} (a)", f"{method} (b)", "Static"]


def test_entries_of_the_same_words_are_numbered(root: Path) -> None:
    again = group_entries([], [root / "clips" / "bad", root / "results" / ".." / "clips" / "bad"], None, never)
    assert [entry.label for entry in again] == ["1. bad", "2. bad"]


def test_a_broken_result_does_not_hide_the_others(root: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "result.json").write_text("{", "utf-8")
    told: list[Exception] = []
    listed = group_entries([broken, root / "results" / "one-dof" / "bad"], [], None, told.append)
    assert [entry.label for entry in listed] == ["bad, IOU 40 %"]
    assert str(broken) in str(told[0])


def test_the_command_refuses_what_it_cannot_show(run: Run, tmp_path: Path) -> None:
    assert run("view")[0] == 2
    status, out, err = run("view", tmp_path / "nowhere")
    assert out == f"reading {tmp_path / 'nowhere'} ...\n"
    assert status == 1
    assert "nowhere: no such folder; must be a result, a clip" in err
