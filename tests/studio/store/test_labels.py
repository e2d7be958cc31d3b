"""Labels as files and as key frames: clicks stay, are undone step by step, and impossible labels are refused."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.cli.annotate import DATABASE
from getagrip.studio.project import Project
from getagrip.studio.store import labels, marks
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import MAX_LABEL_POLYGON_CORNERS, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels
from getagrip.studio.store.mark_store import MARKS_APPLICATION_ID, Store
from getagrip.studio.store.tasks import Task
from helpers.annotation import FIRST, LAST, TAB, VIDEO, Clicking, disc, new
from helpers.labelled_scene import FRAMES, HEIGHT, WIDTH, circle

Refused = Callable[..., str]

NO_JOINTS = np.full((21, 2), np.nan)


def some_labels() -> Labels:
    joints = NO_JOINTS.copy()
    joints[4] = 12.25, 7.5
    square = np.array([[10.0, 10.0], [30.0, 10.0], [30.0, 20.0], [10.0, 20.0]])
    frames = {
        3: FrameLabels(joints, (square,), (square + np.array([15.0, 0.0]),)),
        5: FrameLabels(joints),
        7: FrameLabels(object=()),
    }
    return Labels("plate.mp4", (64, 48), "left", 29.97, 3, 9, frames)


def same(a: Labels, b: Labels) -> bool:
    return labels.labels_to_json(a) == labels.labels_to_json(b)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    labels.write_label_file(some_labels(), tmp_path / "labels.json")
    again = labels.read_label_file(tmp_path / "labels.json")
    assert same(again, some_labels())
    np.testing.assert_array_equal(again.frames[3].joints, some_labels().frames[3].joints)
    assert again.frames[5].object is None
    assert again.frames[7].object == ()
    assert [path.name for path in tmp_path.iterdir()] == ["labels.json"]


points = st.tuples(st.floats(-64, 128), st.floats(-48, 96)).map(list)
shapes = st.lists(st.lists(points, min_size=3, max_size=6).map(np.array), max_size=3).map(tuple)
joints_ = st.lists(st.one_of(st.none(), points), min_size=21, max_size=21).map(
    lambda row: np.array([[np.nan, np.nan] if point is None else point for point in row])
)
one_frame = st.builds(FrameLabels, st.none() | joints_, st.none() | shapes, st.none() | shapes)


@given(st.dictionaries(st.integers(0, 40), one_frame, max_size=4), st.sampled_from(["left", "right"]))
@pytest.mark.slow
def test_any_labels_survive_json(frames: dict[int, FrameLabels], side: Any) -> None:
    imported_labels = Labels("a.mp4", (64, 48), side, 30.0, 0, 40, frames)
    content = json.loads(json.dumps(labels.labels_to_json(imported_labels)))
    assert same(labels.parse_labels(content, "labels.json"), imported_labels)


def test_label_maps_have_the_drawn_pixels_and_what_is_in_front_wins() -> None:
    maps = some_labels().label_maps()
    assert sorted(maps) == [3, 7]
    inside = maps[3][11:19, 11:24]
    assert (inside == OBJECT_LABEL).all()
    assert (maps[3][11:19, 26:44] == OCCLUDER_LABEL).all()
    assert (maps[3] != 0).sum() == pytest.approx(35 * 10, rel=0.15)
    assert not maps[7].any()


def changed(**changes: Any) -> dict[str, Any]:
    return labels.labels_to_json(some_labels()) | changes


def frame(**content: Any) -> dict[str, Any]:
    return changed(frames={"4": content})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (changed(video="../plate.mp4"), ["video", "without folders"]),
        (changed(size=[64]), ["size"]),
        (changed(size=[64, 10**400]), ["size"]),
        (changed(size=[64.0, 48]), ["size"]),
        (changed(side="both"), ["side", "left or right"]),
        (changed(side=["left"]), ["side"]),
        (changed(fps=0), ["fps"]),
        (changed(fps=True), ["fps"]),
        (changed(first=-1), ["first"]),
        (changed(first=True), ["first"]),
        (changed(last=2), ["last", "from 3"]),
        (changed(frames=[]), ["frames"]),
        (changed(frames={"99": {}}), ["frames.99", "3 to 9"]),
        (changed(frames={"-4": {}}), ["frames.-4"]),
        (changed(frames={"04": {}}), ["frames.04"]),
        (changed(frames={"4": []}), ["frames.4"]),
        (changed(other=1), ["other", "unknown key"]),
        (frame(joint=[]), ["frames.4.joint", "unknown key"]),
        (frame(joints=[None] * 20), ["frames.4.joints", "21 points"]),
        (frame(joints=[None] * 20 + [[1.0]]), ["frames.4.joints[20]"]),
        (frame(joints=[None] * 20 + [[1.0, float("nan")]]), ["frames.4.joints[20]"]),
        (frame(joints=[None] * 20 + [[1.0, 10**400]]), ["frames.4.joints[20]", "64 x 48"]),
        (frame(joints=[None] * 20 + [[1.0, "2"]]), ["frames.4.joints[20]"]),
        (frame(object=[[[1, 2], [3, 4]]]), ["frames.4.object[0]", "3 to"]),
        (frame(object=[[[1, 2], [3, 4], [500, 4]]]), ["frames.4.object[0][2]"]),
        (frame(front="all"), ["frames.4.front"]),
        (frame(object=[[[1, 2], [3, 4], [5, 6]]] * 101), ["frames.4.object", "at most 100"]),
    ],
)
def test_what_is_wrong_is_named(content: dict[str, Any], words: list[str], refused: Refused) -> None:
    refused(lambda: labels.parse_labels(content, "labels.json"), "labels.json", *words)


def test_missing_keys_are_named(refused: Refused) -> None:
    for key in labels.labels_to_json(some_labels()):
        content = changed()
        del content[key]
        refused(lambda content=content: labels.parse_labels(content, "labels.json"), f"missing {key}")


def test_json_that_is_none_is_refused(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "labels.json"
    for text in ("[]", '{"frames": {"4": NaN}}', "{" * 100_000, '{"video": "a", "video": "b"}'):
        path.write_text(text)
        refused(lambda: labels.read_label_file(path))


@pytest.mark.slow
def test_what_was_clicked_is_there_when_the_file_is_opened_again(clicking: Clicking) -> None:
    clicking.click(4, joints={"0": [10, 20.126], "1": "unseen"}, outlines=disc(4))
    clicking.click(9, hidden=True)
    before = clicking.labels()
    assert [one["frame"] for one in before] == [4, 9]
    assert before[0]["joints"] == {"0": [10.0, 20.13], "1": "unseen"}
    assert before[0]["number"] == 5
    again = Project(list(clicking.project.tasks.values()), Store(clicking.project.store.path))
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
    path, mark = tmp_path / DATABASE, new()
    with sqlite3.connect(path) as old:
        old.executescript(marks.MARKS_SCHEMA)
        old.execute("PRAGMA user_version = 1")
        old.execute(f"PRAGMA application_id = {MARKS_APPLICATION_ID}")
        old.execute(
            "INSERT INTO versions (change, tab, at, mark, task, annotator, start, end, side, deleted) "
            f"VALUES ('{new()}', '{TAB}', '', '{mark}', '{VIDEO}', 'ann', {FIRST}, {LAST}, 'left', 0)"
        )
    project = Project([Task(VIDEO, VIDEO, scene_video)], Store(path))
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
