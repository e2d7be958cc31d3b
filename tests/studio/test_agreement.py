"""Agreement of two people, and the table of marks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.readers.datasets.epic.epic_tables import read_grasps
from getagrip.stable_grasps import grasp_lists
from getagrip.studio.project import Project
from getagrip.studio.store.export_all import write_mark_files
from getagrip.studio.store.marks import DISCARD_REASONS, Mark, match_grasps, pairwise_agreements, temporal_iou
from helpers.annotation import MARKED_VIDEO, change, grasp, new
from helpers.environment import DATA, Run, needs

EPIC = DATA / "epic" / "epicgrasps_2431.csv"


def a_mark(start: int, end: int, who: str = "ann", side: str = "left", task: str = "t") -> Mark:
    return Mark(new(), task, who, start, end, side, "mug")


intervals = st.tuples(st.integers(0, 50), st.integers(0, 50)).map(lambda pair: (min(pair), max(pair)))


@given(intervals, intervals)
def test_temporal_iou_is_that_of_the_sets_of_frames(a: tuple[int, int], b: tuple[int, int]) -> None:
    ours, theirs = ({*range(start, end + 1)} for start, end in (a, b))
    assert temporal_iou(a, b) == pytest.approx(len(ours & theirs) / len(ours | theirs))


@given(st.lists(intervals, max_size=4), st.lists(intervals, max_size=4))
def test_agreement_is_mutual(a: list[tuple[int, int]], b: list[tuple[int, int]]) -> None:
    ours, theirs = ([a_mark(*one) for one in some] for some in (a, b))
    assert sum(match_grasps(ours, theirs)) == pytest.approx(sum(match_grasps(theirs, ours)))
    assert match_grasps(ours, ours) == [1.0] * len(ours)


def test_agreement_of_known_marks() -> None:
    marks = [a_mark(0, 9), a_mark(20, 29), a_mark(0, 9, "bob"), a_mark(25, 34, "bob"), a_mark(50, 59, "bob")]
    marks += [Mark(new(), "u", who, reason=DISCARD_REASONS[0]) for who in ("ann", "bob")]
    marks += [a_mark(0, 9, task="v"), Mark(new(), "v", "bob", reason=DISCARD_REASONS[1]), a_mark(0, 9, "ann", task="w")]
    (found,) = pairwise_agreements(marks)
    assert (found.tasks, found.both_discarded, found.one_discarded, found.grasps) == (3, 1, 1, 4)
    assert found.iou == pytest.approx((1 + 5 / 15 + 0 + 0) / 4)
    assert found.above_half == pytest.approx(1 / 4)
    assert match_grasps([a_mark(0, 9)], [a_mark(0, 9, side="right")]) == [0.0, 0.0]


def test_the_table_is_read_back_as_epic_grasps(project: Project, tmp_path: Path) -> None:
    grasp(project, 12, 45, task="candidate", entity="red mug")
    grasp(project, 5, 9)
    grasp(project, 5, 9)  # marked twice
    project.change(change(new(), {"start": 50}))  # no end yet
    grasp(project, 1, 30, "bob", "candidate")
    assert write_mark_files(project, tmp_path) == 0
    whole, one = read_grasps(tmp_path / "grasps-ann.csv")
    assert (one.video, one.start, one.end, one.side) == (MARKED_VIDEO, 13, 46, "left")
    assert (one.category, one.entity) == ("mug", "red mug")
    assert (one.start_bound, one.end_bound, one.contact) == (11, 60, 20)
    assert (whole.start, whole.end, whole.contact) == (6, 10, None)
    rows = json.loads((tmp_path / "grasps-ann.json").read_text())
    assert [(row["clip"], row["start"], row["end"]) for row in rows] == [(MARKED_VIDEO, 5, 9), (MARKED_VIDEO, 12, 45)]
    assert [
        one.duration for one in grasp_lists.read_listed_grasps(tmp_path / "grasps-ann.json").grasps
    ] == pytest.approx([0.1, 0.68], abs=1e-3)
    (pair,) = json.loads((tmp_path / "agreement.json").read_text())
    assert pair["iou"] == pytest.approx(temporal_iou((12, 45), (1, 30)))


@needs(EPIC)
def test_the_columns_are_those_published(project: Project) -> None:
    with EPIC.open() as stream:
        assert project.exported("csv", "ann").splitlines()[0] == stream.readline().strip()


def test_the_command_writes_what_was_marked(project: Project, video: Path, run: Run, tmp_path: Path) -> None:
    grasp(project, 12, 45)
    status, out, err = run("annotate", video, "--out", tmp_path, "--export")
    assert status == 0
    assert "ann: list of 1 grasp, " in out
    assert "grasps-ann.csv" in out
    assert err == ""
    assert run("annotate", video, "--out", tmp_path / "empty", "--export")[0] == 2
    assert run("annotate", tmp_path / "absent.mp4", "--out", tmp_path)[0] == 1
