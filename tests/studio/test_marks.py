"""Marks: what is changed stays, changes at once are kept, and what is impossible is refused."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.cli.annotate import MARKS_DATABASE
from getagrip.studio.project import Project
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.mark_store import MarkStore
from getagrip.studio.store.marks import DISCARD_REASONS
from getagrip.studio.store.tasks import Task
from helpers.annotation import MARKED_VIDEO, change, grasp, new, undo


def test_marks_are_there_when_the_file_is_opened_again(project: Project) -> None:
    grasp(project, 10, 40)
    project.change(change(new(), {"reason": "out of view"}, task="candidate"))
    again = Project(list(project.tasks.values()), MarkStore(project.store.path))
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
    other = MarkStore(project.store.path)
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
    made = Project(
        [Task(MARKED_VIDEO, MARKED_VIDEO, video)], MarkStore(tmp_path_factory.mktemp("undo") / MARKS_DATABASE)
    )
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
    refused(lambda: MarkStore(path), "x.sqlite")
    path.unlink()
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE versions (a)")
    refused(lambda: MarkStore(path), "another program")
