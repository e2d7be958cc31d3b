"""Whole interactions: segments as files of a clip's frames and back, what is amiss in words, older projects."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.stable_grasps import grasp_lists
from getagrip.studio.project import Project
from getagrip.studio.store import labels, mark_store, marks
from getagrip.studio.store.export_all import write_mark_files
from getagrip.studio.store.export_clip import new_clip_call
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.mark_store import MARKS_APPLICATION_ID, Store
from getagrip.studio.store.tasks import Task
from helpers.environment import Run
from helpers.labelled_scene import write_video

LYING, TOUCHED, HELD = ("static", 0, 19, "left"), ("contact", 20, 24, "left"), ("grasp", 25, 60, "left")


@pytest.fixture(scope="module")
def video(tmp_path_factory: Any) -> Path:
    return write_video(tmp_path_factory.mktemp("video") / "cup.mp4")


@pytest.fixture
def project(video: Path, tmp_path: Path) -> Iterator[Project]:
    made = Project([Task("cup", "cup", video)], Store(tmp_path / DATABASE))
    yield made
    made.close()


def mark(project: Project, sets: dict[str, Any], who: str = "ann") -> None:
    project.change(
        {"change": str(uuid4()), "mark": str(uuid4()), "task": "cup", "annotator": who, "tab": "tab-one-", "set": sets}
    )


def segments(project: Project, *given: tuple[str, int, int, str]) -> None:
    for state, start, end, side in given:
        mark(project, {"state": state, "start": start, "end": end, "side": side, "category": "cup"})


def test_segments_are_written_in_a_clips_frames_and_read_back(project: Project, tmp_path: Path) -> None:
    segments(project, TOUCHED, HELD, LYING)
    mark(project, {"camera": "still"})
    assert write_mark_files(project, tmp_path) == 0
    file = tmp_path / "segments-ann.json"
    assert json.loads(file.read_text())["cup"] == {
        "segments": [
            {"state": "static", "first": "000001", "last": "000020"},
            {"state": "contact", "first": "000021", "last": "000025", "side": "left"},
            {"state": "grasp", "first": "000026", "last": "000061", "side": "left"},
        ],
        "source": "marked by ann",
        "still_camera": "as ann states",
    }
    (grasp,) = grasp_lists.read_listed_grasps(tmp_path / "grasps-ann.json").grasps  # as study --intervals reads it
    assert (grasp.first, grasp.last, grasp.side, grasp.object) == (25, 60, "left", "cup")
    assert project.import_segments(file, "bob") == 3
    one, other = (json.loads(project.exported("segments", name))["cup"]["segments"] for name in ("ann", "bob"))
    assert one == other
    with pytest.raises(RefusedError, match="already"):
        project.import_segments(file, "ann")


def test_what_is_amiss_is_said_in_words(project: Project, tmp_path: Path) -> None:
    segments(project, LYING, ("contact", 18, 24, "left"), ("grasp", 30, 60, "right"))
    said = project.marks("cup", "ann")["interaction"]
    assert said["overlaps"] == ["Frames 19 to 20 are in two segments, 1 and 2: move the end of one of them."]
    gap, camera, hand = said["hints"]
    assert gap.startswith("Frames 26 to 30 are in no segment, between 2 and 3")
    assert "camera" in camera
    assert "The right hand is the clip's. In segment 2 the other hand" in hand
    with pytest.raises(RefusedError, match="two segments"):
        project.exported("segments", "ann")
    assert write_mark_files(project, tmp_path) == 1
    assert not (tmp_path / "segments-ann.json").exists()


def test_all_of_it_is_labelled_as_one(project: Project) -> None:
    segments(project, LYING, HELD)
    whole = project.marks("cup", "ann")["interaction"]
    asked = {"task": "cup", "annotator": "ann", "grasp": whole["mark"]}
    assert project.labels(asked)["extent"] == (0, 60)
    segments(project, ("free", 61, 65, "left"))
    assert project.labels(asked)["extent"] == (0, 65)  # what is labelled stays where segments are added
    grasp = project._grasp(asked)
    call = new_clip_call(project.labelling.labels(grasp), Path("out"), "cup.mp4", project.labelling._segments(grasp))
    assert call.interval == (1, 66)
    assert call.segments is not None


def test_stable_grasps_alone_are_no_interaction(project: Project) -> None:
    segments(project, HELD, ("grasp", 50, 69, "right"))  # another hand: no matter that they overlap
    assert project.marks("cup", "ann")["interaction"] is None
    assert project.exported("segments", "ann") == "{}\n"


def test_projects_of_older_versions_are_read(tmp_path: Path, video: Path) -> None:
    with sqlite3.connect(tmp_path / DATABASE) as old:
        old.executescript(marks.MARKS_SCHEMA + labels.KEYFRAMES_SCHEMA + mark_store.DRAFTS_SCHEMA)
        old.execute(
            "INSERT INTO versions (change, tab, at, mark, task, annotator, start, end, side, deleted) "
            "VALUES ('a-change-', 'tab-one-', '2026', 'a-mark--', 'cup', 'ann', 3, 9, 'left', 0)"
        )
        old.execute("PRAGMA user_version = 2")
        old.execute(f"PRAGMA application_id = {MARKS_APPLICATION_ID}")
    project = Project([Task("cup", "cup", video)], Store(tmp_path / DATABASE))
    segments(project, LYING)
    assert [one.state for one in project.store.marks.standing()] == ["static", "grasp"]
    project.close()
    again = Store(tmp_path / DATABASE)
    assert [one.state for one in again.marks.standing()] == ["static", "grasp"]
    again.close()


def test_a_draft_is_imported_by_the_command(tmp_path: Path, video: Path, run: Run) -> None:
    file = tmp_path / "found.json"
    file.write_text(json.dumps({"a-clip": {"segments": [{"state": "static", "first": "5", "last": "900"}]}}))
    call = ("annotate", video, "--out", tmp_path, "--import-segments", file, "--annotator", "ann")
    status, out, _ = run(*call)
    assert (status, "ann: 1 segment;" in out) == (0, True)
    status, out, err = run("annotate", video, "--out", tmp_path, "--export")
    assert (status, "segments of 1 clip," in out, "camera" in err) == (0, True, True)
    written = json.loads((tmp_path / "segments-ann.json").read_text())["cup"]["segments"]
    assert written == [{"state": "static", "first": "000005", "last": "000070"}]
    assert run(*call)[0] == 2


def test_impossible_states_are_refused(project: Project) -> None:
    for sets in ({"state": "held", "start": 3}, {"camera": "moving"}, {"camera": "still", "start": 3}):
        with pytest.raises(RefusedError):
            mark(project, sets)


def test_no_hand_is_guessed(project: Project) -> None:
    """A push by a hand that nobody has stated can be marked, but neither written nor labelled."""
    mark(project, {"start": 3, "end": 9, "state": "contact"})
    (whole,) = project.interactions("ann")
    assert whole.side is None
    assert any("Which hand" in hint for hint in whole.hints())
    with pytest.raises(RefusedError, match="which hand touches the object"):
        whole.listed()
    for grasp in project._grasps(whole.task, "ann").values():
        with pytest.raises(RefusedError, match="which hand"):
            _ = grasp.side


def test_a_stable_grasp_is_not_finished_without_a_hand(project: Project) -> None:
    with pytest.raises(RefusedError, match="which hand"):
        mark(project, {"start": 3, "end": 9, "state": "grasp"})
