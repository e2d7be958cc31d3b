"""Marks: nothing that was ever entered is lost, changes of different fields go together, exports read back."""

from __future__ import annotations

import json
import sqlite3
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.annotate.agreement import agreements, matched, temporal_iou
from getagrip.annotate.marks import REASONS, Mark
from getagrip.annotate.project import Project
from getagrip.annotate.server import LARGEST_BODY, Server, first_free, kept_token
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import Task
from getagrip.annotate.versions import RefusedError
from getagrip.commands.annotate import DATABASE, write_files
from getagrip.datasets.epic.tables import read_grasps
from getagrip.errors import UsageError
from getagrip.grasps import lists
from helpers.annotation_page import ask
from helpers.command_line import Run
from helpers.numbered_footage import FRAMES, number_in, write_images, write_video
from helpers.paths import DATA, needs

VIDEO = "P01_101"
EPIC = DATA / "epic" / "epicgrasps_2431.csv"


@pytest.fixture(scope="module")
def video(tmp_path_factory: Any) -> Path:
    return write_video(tmp_path_factory.mktemp("video") / f"{VIDEO}.mp4", fps=50)


@pytest.fixture
def project(video: Path, tmp_path: Path) -> Iterator[Project]:
    """A video as a whole, and a candidate in it."""
    candidate = Task("candidate", VIDEO, video, 11, 60, "left", "mug", "red mug", contact=20)
    made = Project([Task(VIDEO, VIDEO, video), candidate], Store(tmp_path / DATABASE))
    yield made
    made.close()


def new() -> str:
    return str(uuid.uuid4())


def change(
    mark: str, sets: dict[str, Any], who: str = "ann", task: str = VIDEO, tab: str = "tab-one-"
) -> dict[str, Any]:
    return {"change": new(), "mark": mark, "task": task, "annotator": who, "tab": tab, "set": sets}


def undo(who: str = "ann", task: str = VIDEO, tab: str = "tab-one-") -> dict[str, Any]:
    return {"change": new(), "task": task, "annotator": who, "tab": tab}


def grasp(project: Project, start: int, end: int, who: str = "ann", task: str = VIDEO, **more: Any) -> str:
    mark = new()
    project.change(change(mark, {"start": start, "side": "left", "category": "mug", **more}, who, task))
    project.change(change(mark, {"end": end}, who, task))
    return mark


def test_marks_are_there_when_the_file_is_opened_again(project: Project) -> None:
    grasp(project, 10, 40)
    project.change(change(new(), {"reason": "out of view"}, task="candidate"))
    again = Project(list(project.tasks.values()), Store(project.store.path))
    assert again.store.marks.standing() == project.store.marks.standing()
    assert [task["state"] for task in again.overview("ann")["tasks"]] == ["marked", "discarded"]
    assert [task["state"] for task in again.overview("bob")["tasks"]] == ["", ""]
    (mark,) = again.marks(VIDEO, "ann")["marks"]
    assert (mark["start"], mark["end"], mark["start_number"], mark["end_number"]) == (10, 40, 11, 41)
    assert mark["seconds"] == pytest.approx(31 / 50, abs=1e-3)
    again.close()


def test_two_tabs_that_change_one_mark_lose_nothing(project: Project) -> None:
    mark = grasp(project, 10, 40)
    project.change(change(mark, {"end": 50}, tab="tab-one-"))
    project.change(change(mark, {"category": "cup"}, tab="tab-two-"))
    project.change(change(mark, {"start": 12}, tab="tab-one-"))
    (state,) = project.store.marks.standing(VIDEO)
    assert (state.start, state.end, state.category) == (12, 50, "cup")
    assert [one.end for one in project.store.marks.history(mark)] == [None, 40, 50, 50, 50]


@pytest.mark.slow
def test_changes_at_once_are_all_kept(project: Project) -> None:
    marks = [new() for _ in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda mark: project.change(change(mark, {"start": 3})), marks))
    assert {mark.mark for mark in project.store.marks.standing(VIDEO)} == {*marks}


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
    made = Project([Task(VIDEO, VIDEO, video)], Store(tmp_path_factory.mktemp("undo") / DATABASE))
    marks, states = [new() for _ in range(3)], [made.store.marks.standing()]
    for which, field, value in steps:
        given_value = {"side": "left" if value % 2 else "right", "deleted": bool(value % 2)}.get(field, value)
        try:
            made.change(change(marks[which], {field: given_value}))
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
    project.change(change(theirs, {"start": 2}, tab="tab-two-"))
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
        {"start": 9, "end": 8}, {"reason": "bored"}, {"start": 1, "reason": REASONS[0]}, {"side": "both"},
        {"start": 1, "category": ""},
        {"start": 1, "category": "a\nb"}, {"start": 1, "colour": "red"}, {"side": "left"},
    ],
)  # fmt: skip
def test_impossible_changes_are_refused_and_change_nothing(project: Project, sets: dict[str, Any]) -> None:
    with pytest.raises(RefusedError):
        project.change(change(new(), sets))
    assert project.store.marks.newest(VIDEO, "ann") == 0


@pytest.mark.parametrize("key", ["change", "mark", "tab", "annotator", "task"])
def test_changes_of_nobody_are_refused(project: Project, key: str) -> None:
    for value in (None, "", "../../x", 3, "a" * 300):
        with pytest.raises(RefusedError):
            project.change(change(new(), {"start": 1}) | {key: value})


def test_marks_of_others_are_out_of_reach(project: Project) -> None:
    mark = grasp(project, 1, 5, "ann")
    with pytest.raises(RefusedError, match="belongs"):
        project.change(change(mark, {"start": 2}, "bob"))
    assert project.marks(VIDEO, "bob")["marks"] == []


def test_other_files_are_no_databases_of_marks(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "x.sqlite"
    path.write_text("no database, " * 100)
    refused(lambda: Store(path), "x.sqlite")
    path.unlink()
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE versions (a)")
    refused(lambda: Store(path), "another kind")


# ---- agreement and export ----------------------------------------------------------------------------------------


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
    assert sum(matched(ours, theirs)) == pytest.approx(sum(matched(theirs, ours)))
    assert matched(ours, ours) == [1.0] * len(ours)


def test_agreement_of_known_marks() -> None:
    marks = [a_mark(0, 9), a_mark(20, 29), a_mark(0, 9, "bob"), a_mark(25, 34, "bob"), a_mark(50, 59, "bob")]
    marks += [Mark(new(), "u", who, reason=REASONS[0]) for who in ("ann", "bob")]
    marks += [a_mark(0, 9, task="v"), Mark(new(), "v", "bob", reason=REASONS[1]), a_mark(0, 9, "ann", task="w")]
    (found,) = agreements(marks)
    assert (found.tasks, found.both_discarded, found.one_discarded, found.grasps) == (3, 1, 1, 4)
    assert found.iou == pytest.approx((1 + 5 / 15 + 0 + 0) / 4)
    assert found.above_half == pytest.approx(1 / 4)
    assert matched([a_mark(0, 9)], [a_mark(0, 9, side="right")]) == [0.0, 0.0]


def test_the_table_is_read_back_as_epic_grasps(project: Project, tmp_path: Path) -> None:
    grasp(project, 12, 45, task="candidate", entity="red mug")
    grasp(project, 5, 9)
    grasp(project, 5, 9)  # marked twice
    project.change(change(new(), {"start": 50}))  # no end yet
    grasp(project, 1, 30, "bob", "candidate")
    assert write_files(project, tmp_path) == 0
    whole, one = read_grasps(tmp_path / "grasps-ann.csv")
    assert (one.video, one.start, one.end, one.side) == (VIDEO, 13, 46, "left")
    assert (one.category, one.entity) == ("mug", "red mug")
    assert (one.start_bound, one.end_bound, one.contact) == (11, 60, 20)
    assert (whole.start, whole.end, whole.contact) == (6, 10, None)
    rows = json.loads((tmp_path / "grasps-ann.json").read_text())
    assert [(row["clip"], row["start"], row["end"]) for row in rows] == [(VIDEO, 5, 9), (VIDEO, 12, 45)]
    assert [one.duration for one in lists.read(tmp_path / "grasps-ann.json").grasps] == pytest.approx(
        [0.1, 0.68], abs=1e-3
    )
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
    assert "ann: 1 grasps" in out
    assert "grasps-ann.csv" in out
    assert err == ""
    assert run("annotate", video, "--out", tmp_path / "empty", "--export")[0] == 2
    assert run("annotate", tmp_path / "absent.mp4", "--out", tmp_path)[0] == 1


# ---- HTTP --------------------------------------------------------------------------------------------------------


@pytest.fixture
def server(project: Project) -> Iterator[Server]:
    with Server(project, 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def test_frames_and_marks_over_http(server: Server) -> None:
    for n in (0, 33, FRAMES - 1, 12):
        status, head, image = ask(server, f"/frame?task={VIDEO}&n={n}")
        assert (status, head["X-Number"], number_in(image)) == (200, str(n + 1), n)
    status, _, answer = ask(server, "/api/change", change(new(), {"start": 4}))
    assert (status, json.loads(answer)["marks"][0]["start"]) == (200, 4)
    info = json.loads(ask(server, "/api/task?task=candidate")[2])
    assert (info["first"], info["last"], info["contact"]) == (10, 59, 19)
    for path in ("/", "/page.js", "/player.js", "/saving.js", "/page.css"):
        status, head, text = ask(server, path)
        assert status == 200
        assert b"http" not in text.replace(b"http-equiv", b"")  # nothing from elsewhere
        assert "default-src 'self'" in head["Content-Security-Policy"]


def test_the_page_is_for_this_machine_only(server: Server) -> None:
    assert server.server_address[0] == "127.0.0.1"
    own = f"127.0.0.1:{server.server_port}"
    sent = change(new(), {"start": 4})
    foreign: list[dict[str, str]] = [
        {"Host": "evil.example"}, {"Host": f"evil.example:{server.server_port}"}, {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": f"https://{own}"},
        {"Origin": "http://127.0.0.1:1"}, {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
    ]  # fmt: skip
    for head in foreign:
        assert ask(server, "/api/change", sent, head)[0] == 403
        assert ask(server, f"/frame?task={VIDEO}&n=0", head=head)[0] == 403
    assert server.project.store.marks.standing() == []
    assert ask(server, "/api/change", sent, {"Origin": f"http://{own}"})[0] == 200
    assert ask(server, "/", head={"Host": f"localhost:{server.server_port}"})[0] == 200
    through_ssh = {"Host": "localhost:9000", "Origin": "http://localhost:9000"}
    assert ask(server, "/api/change", change(new(), {"start": 5}), through_ssh)[0] == 200


def test_the_address_with_the_token_opens_the_page(server: Server) -> None:
    """Others who work on the machine reach the server, but nothing of what is in it."""
    stranger = {"Cookie": ""}
    for path in ("/", "/page.js", "/api/tasks?annotator=ann", "/?token=another", f"/page.js?token={server.token}"):
        status, _, answer = ask(server, path, head=stranger)
        assert (status, b"the address that getagrip annotate has printed" in answer) == (401, True)
    for cookie in (f"{server.cookie}=another", f"other={server.token}", f"{server.cookie}", "a=\xff"):
        assert ask(server, "/api/change", change(new(), {"start": 4}), {"Cookie": cookie})[0] == 401
    assert server.project.store.marks.standing() == []
    status, head, _ = ask(server, server.url.removeprefix(f"http://127.0.0.1:{server.server_port}"), head=stranger)
    assert (status, head["Location"]) == (303, "/")
    assert "HttpOnly" in head["Set-Cookie"]
    assert ask(server, "/", head={"Cookie": head["Set-Cookie"].partition(";")[0]})[0] == 200


def test_the_token_stays_over_restarts_and_is_its_owners(tmp_path: Path) -> None:
    token = kept_token(tmp_path / "token")
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
    assert kept_token(tmp_path / "token") == token
    (tmp_path / "token").chmod(0o644)  # others may have read it
    assert kept_token(tmp_path / "token") != token


def test_another_port_is_taken_where_the_usual_one_is_not_free(project: Project, monkeypatch: Any) -> None:
    with Server(project, 0) as busy:
        monkeypatch.setattr("getagrip.annotate.server.PORT", busy.server_port)
        with first_free(project, "a-token") as other:
            assert other.server_port != busy.server_port
        with pytest.raises(UsageError, match="--port"):
            Server(project, busy.server_port)


@pytest.mark.parametrize(
    ("path", "content", "expected"),
    [
        ("/frame?task=nothing&n=0", None, 409), (f"/frame?task={VIDEO}&n=70", None, 409),
        (f"/frame?task={VIDEO}&n=-1", None, 400), (f"/frame?task={VIDEO}", None, 400), ("/frame", None, 400),
        ("/../cli.py", None, 404), ("/page.js/../store.py", None, 404), ("/api/marks", None, 409),
        ("/api/tasks?annotator=..%2Fx", None, 409), ("/grasps.csv?annotator=", None, 409),
        ("/api/change", b"{", 400), ("/api/change", b"[]", 400), ("/api/change", b"[" * 60_000, 400),
        ("/api/change", b"\xff\xfe", 400), ("/api/change", {}, 409), ("/api/undo", {}, 409), ("/api/other", {}, 404),
        ("/api/change", b" " * (LARGEST_BODY + 1), 400),
    ],
)  # fmt: skip
def test_bad_requests_are_answered_in_words(server: Server, path: str, content: object, expected: int) -> None:
    status, head, answer = ask(server, path, content)
    assert (status, head["Content-Type"]) == (expected, "application/json")
    assert set(json.loads(answer)) == {"error"}


def test_forms_of_other_sites_cannot_be_sent(server: Server) -> None:
    """A form can be sent across sites without asking; JSON cannot."""
    head = {"Content-Type": "text/plain"}
    assert ask(server, "/api/change", change(new(), {"start": 1}), head)[0] == 400


def test_a_database_that_cannot_be_written_is_reported(server: Server) -> None:
    other = sqlite3.connect(server.project.store.path)
    server.project.store.database.connection.execute("PRAGMA busy_timeout = 50")
    other.execute("BEGIN EXCLUSIVE")
    sent = change(new(), {"start": 4})
    assert ask(server, "/api/change", sent)[0] == 503
    other.execute("ROLLBACK")
    other.close()
    assert ask(server, "/api/change", sent)[0] == 200


def test_a_port_in_use_is_reported(server: Server, video: Path, run: Run, tmp_path: Path) -> None:
    status, _, err = run("annotate", video, "--out", tmp_path / "other", "--port", server.server_port)
    assert status == 2
    assert "--port" in err


def test_a_folder_of_images_is_served(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "P01_01", [7, 8, 9])
    project = Project([Task("P01_01", "P01_01", folder)], Store(tmp_path / DATABASE))
    image, _, number = project.frame("P01_01", 2)
    assert (number_in(image), number) == (9, 9)
    project.close()
