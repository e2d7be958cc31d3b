"""Key frames: what is clicked stays, is undone step by step, and what no person can click is refused."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.cli.annotate import MARKS_DATABASE
from getagrip.studio.project import Project
from getagrip.studio.store import marks
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import MAX_LABEL_POLYGON_CORNERS
from getagrip.studio.store.mark_store import MARKS_APPLICATION_ID, MarkStore
from getagrip.studio.store.tasks import Task
from helpers.annotation import FIRST, LAST, TAB, VIDEO, Clicking, disc, new
from helpers.labelled_scene import FRAMES, HEIGHT, WIDTH, circle


@pytest.mark.slow
def test_what_was_clicked_is_there_when_the_file_is_opened_again(clicking: Clicking) -> None:
    clicking.click(4, joints={"0": [10, 20.126], "1": "unseen"}, outlines=disc(4))
    clicking.click(9, hidden=True)
    before = clicking.labels()
    assert [one["frame"] for one in before] == [4, 9]
    assert before[0]["joints"] == {"0": [10.0, 20.13], "1": "unseen"}
    assert before[0]["number"] == 5
    again = Project(list(clicking.project.tasks.values()), MarkStore(clicking.project.store.path))
    assert again.labels(clicking.about)["keyframes"] == before
    again.close()


def test_two_tabs_that_click_on_one_frame_lose_nothing(clicking: Clicking) -> None:
    clicking.click(4, "tab-one-", joints={"0": [10, 20], "1": [30, 40]})
    clicking.click(4, "tab-two-", joints={"2": [50, 60]}, outlines=disc(4, closed=False))
    clicking.click(4, "tab-one-", joints={"1": [31, 41]}, outlines={"another-": disc(5)["the-disc"]})
    (frame,) = clicking.labels()
    assert frame["joints"] == {"0": [10.0, 20.0], "1": [31.0, 41.0], "2": [50.0, 60.0]}
    assert frame["outlines"].keys() == {"the-disc", "another-"}
    with pytest.raises(RefusedError, match="another tab"):
        clicking.undo("tab-two-")
    assert clicking.undo("tab-one-")["frame"] == 4
    (frame,) = clicking.labels()
    assert frame["joints"]["1"] == [30.0, 40.0]


steps = st.lists(
    st.tuples(
        st.integers(FIRST, FIRST + 2),
        st.one_of(
            st.builds(
                lambda n, x: {"joints": {str(n): x}}, st.integers(0, 3), st.sampled_from([[1, 2], "unseen", None])
            ),
            st.builds(lambda c: {"outlines": {"the-disc": c}}, st.sampled_from([disc(3)["the-disc"], None])),
            st.builds(lambda b: {"hidden": b}, st.booleans()),
            st.just({"deleted": True}),
        ),
    ),
    max_size=8,
)


@settings(max_examples=10)
@given(steps)
@pytest.mark.slow
def test_undo_goes_back_through_every_state(
    tmp_path_factory: Any, scene_video: Path, steps: list[tuple[int, dict[str, Any]]]
) -> None:
    made = Clicking(scene_video, tmp_path_factory.mktemp("undo"))
    states = [made.labels()]
    for frame, sets in steps:
        made.click(frame, **sets)
        states.append(made.labels())
    for state in reversed(states[:-1]):
        assert made.undo()["undone"]
        assert made.labels() == state
    assert not made.undo()["undone"]
    assert len(made.project.marks(VIDEO, "ann")["marks"]) == 1  # of clicks, not of the grasp
    made.project.close()


def test_a_frame_without_anything_is_no_key_frame_and_can_be_begun_again(clicking: Clicking) -> None:
    clicking.click(4, joints={"0": [10, 20], "1": [1, 1]}, outlines=disc(4))
    clicking.click(4, deleted=True)
    assert clicking.labels() == []
    clicking.click(4, joints={"2": [10, 20]})
    assert clicking.labels()[0]["joints"] == {"2": [10.0, 20.0]}
    clicking.click(4, joints={"2": None})
    assert clicking.labels() == []


def test_a_click_that_is_sent_twice_is_made_once(clicking: Clicking) -> None:
    sent = clicking.change(4, {"joints": {"0": [10, 20]}})
    clicking.project.label(sent)
    clicking.project.label(sent)
    assert len(clicking.project.store.keyframes.history(f"{clicking.about['grasp']}:4")) == 1


def test_databases_of_marks_alone_are_completed(scene_video: Path, tmp_path: Path) -> None:
    path, mark = tmp_path / MARKS_DATABASE, new()
    with sqlite3.connect(path) as old:
        old.executescript(marks.MARKS_SCHEMA)
        old.execute("PRAGMA user_version = 1")
        old.execute(f"PRAGMA application_id = {MARKS_APPLICATION_ID}")
        old.execute(
            "INSERT INTO versions (change, tab, at, mark, task, annotator, start, end, side, deleted) "
            f"VALUES ('{new()}', '{TAB}', '', '{mark}', '{VIDEO}', 'ann', {FIRST}, {LAST}, 'left', 0)"
        )
    project = Project([Task(VIDEO, VIDEO, scene_video)], MarkStore(path))
    about = {"task": VIDEO, "annotator": "ann", "grasp": mark}
    project.label(about | {"change": new(), "tab": TAB, "frame": 4, "set": {"joints": {"0": [1, 2]}}})
    assert len(project.labels(about)["keyframes"]) == 1
    project.close()


NAN, INFINITE = float("nan"), float("inf")


POINTS: list[Any] = [
    [NAN, 1], [1, INFINITE], [1], [1, 2, 3], "12", [True, 1], ["1", 2], {}, [[1, 2]], 7, [-WIDTH - 1, 0], [0, 1e300],
    [10**400, 0],
]  # fmt: skip


POLYGONS: list[Any] = [
    [], "x", 3, {"of": "object", "closed": True}, {"of": "palm", "closed": True, "points": circle(3)},
    {"of": "object", "closed": 1, "points": circle(3)}, {"of": "object", "closed": True, "points": circle(3)[:2]},
    {"of": "object", "closed": False, "points": []}, {"of": "object", "closed": True, "points": "abc"},
    {"of": "object", "closed": True, "points": [[1, 1]] * (MAX_LABEL_POLYGON_CORNERS + 1)},
    {"of": ["object"], "closed": True, "points": circle(3)},
    {"of": "object", "closed": True, "points": [*circle(3), [NAN, 0]]},
    {"of": "object", "closed": True, "points": [*circle(3), [0, 2 * HEIGHT + 1]]},
    {"of": "object", "closed": True, "points": circle(3), "more": 1},
]  # fmt: skip


SETS: list[Any] = [
    {}, [], None, "joints", {"colour": 1}, {"joints": []}, {"joints": {"21": [1, 2]}}, {"joints": {"-1": [1, 2]}},
    {"joints": {"0.0": [1, 2]}}, {"joints": {"": [1, 2]}}, {"outlines": [1]}, {"outlines": {"../../x": None}},
    {"outlines": {"a": disc(3)["the-disc"]}}, {"hidden": 1}, {"hidden": None}, {"deleted": "yes"},
    {"outlines": {f"outline-{n}": disc(3)["the-disc"] for n in range(101)}},
    *({"joints": {"0": point}} for point in POINTS), *({"outlines": {"the-disc": one}} for one in POLYGONS),
]  # fmt: skip


@pytest.mark.parametrize("sets", SETS, ids=range(len(SETS)))
def test_impossible_clicks_are_refused_and_change_nothing(clicking: Clicking, sets: Any) -> None:
    with pytest.raises(RefusedError):
        clicking.project.label(clicking.change(4, sets))
    assert clicking.state()["newest"] == 0


@pytest.mark.parametrize("frame", [-1, FRAMES, 10**30, "4", 4.0, True, None, [4]])
def test_frames_that_are_not_there_are_refused(clicking: Clicking, frame: Any) -> None:
    with pytest.raises(RefusedError):
        clicking.project.label(clicking.change(frame, {"joints": {"0": [1, 2]}}))


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@given(json_values, st.sampled_from(["joints", "outlines", "hidden", "deleted", "points", "point"]))
@pytest.mark.slow
def test_any_json_is_kept_or_refused(scene_video: Path, tmp_path_factory: Any, value: Any, where: str) -> None:
    made = Clicking(scene_video, tmp_path_factory.mktemp("any"))
    whole = {"of": "object", "closed": True, "points": value}
    sets = {"points": {"outlines": {"the-disc": whole}}, "point": {"joints": {"3": value}}}.get(where, {where: value})
    try:
        made.click(4, **sets)
    except RefusedError:
        assert made.state()["newest"] == 0
    json.dumps(made.state(), allow_nan=False)
    made.project.labelling.labels(made.project._grasp(made.about))
    made.project.close()


def test_grasps_of_others_are_out_of_reach(clicking: Clicking) -> None:
    for key, value in (("annotator", "bob"), ("grasp", new()), ("grasp", None), ("grasp", ["x"]), ("task", "other")):
        for act in (clicking.project.label, clicking.project.unlabel, clicking.project.work, clicking.project.labels):
            with pytest.raises(RefusedError):
                act(clicking.change(4, {"joints": {"0": [1, 2]}}) | {"work": "propagate", key: value})
    clicking.project.change(
        clicking.about | {"change": new(), "mark": clicking.about["grasp"], "tab": TAB, "set": {"end": None}}
    )
    with pytest.raises(RefusedError, match="end of the grasp"):
        clicking.state()
