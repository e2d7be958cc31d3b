"""Marks stay, are undone step by step, and impossible ones are refused; agreement, and the table."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.cli.annotate import DATABASE
from getagrip.readers.datasets.epic.epic_tables import read_grasps
from getagrip.stable_grasps import grasp_lists
from getagrip.studio.project import Project
from getagrip.studio.store.export_all import write_mark_files
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.marks import DISCARD_REASONS, Mark, match_grasps, pairwise_agreements, temporal_iou
from getagrip.studio.store.tasks import Task
from helpers.annotation import MARKED_VIDEO, change, grasp, new, undo
from helpers.environment import DATA, Run, needs


def test_marks_are_there_when_the_file_is_opened_again(project: Project) -> None:
    grasp(project, 10, 40)
    project.change(change(new(), {"reason": "out of view"}, task="candidate"))
    again = Project(list(project.tasks.values()), Store(project.store.path))
    assert again.store.marks.standing() == project.store.marks.standing()
    assert [task["state"] for task in again.overview("ann")["tasks"]] == ["marked", "discarded"]
    assert [task["state"] for task in again.overview("bob")["tasks"]] == ["", ""]
    (mark,) = again.marks(MARKED_VIDEO, "ann")["marks"]
    assert (mark["start"], mark["end"], mark["start_number"], mark["end_number"]) == (10, 40, 11, 41)
    assert mark["seconds"] == pytest.approx(31 / 50, abs=1e-3)
    again.close()


def test_two_tabs_that_change_one_mark_lose_nothing(project: Project) -> None:
    mark = grasp(project, 10, 40)
    project.change(change(mark, {"end": 50}, tab="tab-one-"))
    project.change(change(mark, {"category": "cup"}, tab="tab-two-"))
    project.change(change(mark, {"start": 12}, tab="tab-one-"))
    (state,) = project.store.marks.standing(MARKED_VIDEO)
    assert (state.start, state.end, state.category) == (12, 50, "cup")
    assert [one.end for one in project.store.marks.history(mark)] == [None, 40, 50, 50, 50]


@pytest.mark.slow
def test_changes_at_once_are_all_kept(project: Project) -> None:
    marks = [new() for _ in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda mark: project.change(change(mark, {"start": 3})), marks))
    assert {mark.mark for mark in project.store.marks.standing(MARKED_VIDEO)} == {*marks}


def test_two_processes_may_share_a_file(project: Project) -> None:
    other = Store(project.store.path)
    grasp(project, 10, 40)
    assert other.marks.standing() == project.store.marks.standing()
    other.close()


def test_a_change_that_is_sent_twice_is_made_once(project: Project) -> None:
    sent = change(new(), {"start": 5})
    assert project.change(sent) == project.change(sent)
    assert len(project.store.marks.history(sent["mark"])) == 1
    taken = undo()
    assert project.undo(taken)["undone"]
    project.undo(taken)
    assert len(project.store.marks.history(sent["mark"])) == 2


@settings(max_examples=10)
@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from(["start", "end", "side", "deleted"]), st.integers(0, 69))))
@pytest.mark.slow
def test_undo_goes_back_through_every_state(
    tmp_path_factory: Any, video: Path, steps: list[tuple[int, str, int]]
) -> None:
    made = Project([Task(MARKED_VIDEO, MARKED_VIDEO, video)], Store(tmp_path_factory.mktemp("undo") / DATABASE))
    marks, states = [new() for _ in range(3)], [made.store.marks.standing()]
    for which, field, value in steps:
        input_value = {"side": "left" if value % 2 else "right", "deleted": bool(value % 2)}.get(field, value)
        try:
            made.change(change(marks[which], {field: input_value}))
        except RefusedError:
            continue
        states.append(made.store.marks.standing())
    for state in reversed(states[:-1]):
        assert made.undo(undo())["undone"]
        assert made.store.marks.standing() == state
    assert not made.undo(undo())["undone"]
    made.close()


def test_a_tab_undoes_its_own_changes_only(project: Project) -> None:
    mine, theirs = new(), new()
    project.change(change(mine, {"start": 1}, tab="tab-one-"))
    project.change(change(theirs, {"start": 2, "side": "left"}, tab="tab-two-"))
    project.undo(undo(tab="tab-one-"))
    assert [mark.mark for mark in project.store.marks.standing()] == [theirs]
    project.change(change(theirs, {"end": 9}, tab="tab-one-"))
    with pytest.raises(RefusedError, match="another tab"):
        project.undo(undo(tab="tab-two-"))
    assert project.store.marks.standing()[0].end == 9


@pytest.mark.parametrize(
    "sets",
    [
        {}, {"start": 70}, {"start": -1}, {"start": "1"}, {"start": True}, {"start": 10**30}, {"end": 5},
        {"start": 9, "end": 8}, {"start": 1, "end": 5}, {"reason": "bored"}, {"start": 1, "reason": DISCARD_REASONS[0]},
        {"side": "both"}, {"start": 1, "category": ""},
        {"start": 1, "category": "a\nb"}, {"start": 1, "colour": "red"}, {"side": "left"},
    ],
)  # fmt: skip
def test_impossible_changes_are_refused_and_change_nothing(project: Project, sets: dict[str, Any]) -> None:
    with pytest.raises(RefusedError):
        project.change(change(new(), sets))
    assert project.store.marks.newest(MARKED_VIDEO, "ann") == 0


@pytest.mark.parametrize("key", ["change", "mark", "tab", "annotator", "task"])
def test_changes_of_nobody_are_refused(project: Project, key: str) -> None:
    for value in (None, "", "../../x", 3, "a" * 300):
        with pytest.raises(RefusedError):
            project.change(change(new(), {"start": 1}) | {key: value})


def test_marks_of_others_are_out_of_reach(project: Project) -> None:
    mark = grasp(project, 1, 5, "ann")
    with pytest.raises(RefusedError, match="belongs"):
        project.change(change(mark, {"start": 2}, "bob"))
    assert project.marks(MARKED_VIDEO, "bob")["marks"] == []


def test_other_files_are_no_databases_of_marks(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "x.sqlite"
    path.write_text("no database, " * 100)
    refused(lambda: Store(path), "x.sqlite")
    path.unlink()
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE versions (a)")
    refused(lambda: Store(path), "another program")


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
