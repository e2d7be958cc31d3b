"""Files of clicked labels: round trips, what is drawn, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.studio.store import labels
from getagrip.studio.store.labels import OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels

Refused = Callable[..., str]

NAN = np.full((21, 2), np.nan)


def some_labels() -> Labels:
    joints = NAN.copy()
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
