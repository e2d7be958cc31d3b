"""The server of the page: frames, marks and labels, for users with the token on this machine only; hostile requests."""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.errors import UsageError
from getagrip.studio import jobs
from getagrip.studio.project import Project
from getagrip.studio.server import MAX_BODY_BYTES, Server, persistent_token, serve_on_free_port
from getagrip.studio.store import labels
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.tasks import Task
from helpers.annotation import FIRST, LAST, MARKED_VIDEO, TAB, VIDEO, Clicking, ask, change, new
from helpers.environment import Run
from helpers.labelled_scene import NUMBERED_FRAMES, number_in, write_images


@contextmanager
def serving(project: Project) -> Iterator[Server]:
    with Server(project, 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


@pytest.fixture
def server(project: Project) -> Iterator[Server]:
    with serving(project) as made:
        yield made


@pytest.fixture
def label_server(clicking: Clicking) -> Iterator[Server]:
    with serving(clicking.project) as made:
        yield made


def test_frames_and_marks_over_http(server: Server) -> None:
    for n in (0, 33, NUMBERED_FRAMES - 1, 12):
        status, head, image = ask(server, f"/frame?task={MARKED_VIDEO}&n={n}")
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
        assert ask(server, f"/frame?task={MARKED_VIDEO}&n=0", head=head)[0] == 403
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
    token = persistent_token(tmp_path / "token")
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
    assert persistent_token(tmp_path / "token") == token
    (tmp_path / "token").chmod(0o644)  # others may have read it
    assert persistent_token(tmp_path / "token") != token


def test_a_token_is_neither_short_nor_read_through_a_link(tmp_path: Path) -> None:
    for content in ("a", "secret-of-the-users-own-that-is-long"):
        other, token = tmp_path / "other", tmp_path / "token"
        other.write_text(content)
        other.chmod(0o600)
        token.unlink(missing_ok=True)
        token.symlink_to(other)
        assert len(persistent_token(token)) >= 20
        assert not token.is_symlink()
        assert other.read_text() == content
        token.write_text("a")
        assert len(persistent_token(token)) >= 20


def test_another_port_is_taken_where_the_default_one_is_in_use(project: Project, monkeypatch: Any) -> None:
    with Server(project, 0) as busy:
        monkeypatch.setattr("getagrip.studio.server.DEFAULT_PORT", busy.server_port)
        with serve_on_free_port(project, "a-token") as other:
            assert other.server_port != busy.server_port
        with pytest.raises(UsageError, match="--port"):
            Server(project, busy.server_port)


@pytest.mark.parametrize(
    ("path", "content", "expected"),
    [
        ("/frame?task=nothing&n=0", None, 409), (f"/frame?task={MARKED_VIDEO}&n=70", None, 409),
        (f"/frame?task={MARKED_VIDEO}&n=-1", None, 400), (f"/frame?task={MARKED_VIDEO}", None, 400),
        ("/frame", None, 400), ("/../cli.py", None, 404), ("/page.js/../store.py", None, 404),
        ("/api/marks", None, 409), ("/api/tasks?annotator=..%2Fx", None, 409), ("/grasps.csv?annotator=", None, 409),
        ("/api/change", b"{", 400), ("/api/change", b"[]", 400), ("/api/change", b"[" * 60_000, 400),
        ("/api/change", b"\xff\xfe", 400), ("/api/change", {}, 409), ("/api/undo", {}, 409), ("/api/other", {}, 404),
        ("/api/change", b" " * (MAX_BODY_BYTES + 1), 400),
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


def test_labels_over_http(label_server: Server, clicking: Clicking) -> None:
    where = "&".join(f"{key}={value}" for key, value in clicking.about.items())
    status, _, answer = ask(label_server, "/api/label", clicking.change(4, {"joints": {"0": [10, 20]}}))
    assert (status, json.loads(answer)["keyframes"][0]["frame"]) == (200, 4)
    assert json.loads(ask(label_server, f"/api/labels?{where}")[2])["extent"] == [FIRST, LAST]
    assert json.loads(ask(label_server, f"/api/drafts?{where}&since=0")[2]) == {"drafts": []}
    status, head, text = ask(label_server, f"/labels.json?{where}")
    assert status == 200
    assert f"labels-ann-scene-{FIRST + 1}-{LAST + 1}-left.json" in head["Content-Disposition"]
    assert labels.parse_labels(json.loads(text), "labels.json").frames.keys() == {4}
    status, _, image = ask(label_server, f"/frame?task={VIDEO}&n=4&whole=1")
    assert (status, image[:2]) == (200, b"\xff\xd8")
    status, _, answer = ask(label_server, "/api/unlabel", clicking.about | {"change": new(), "tab": TAB})
    assert (json.loads(answer)["undone"], json.loads(answer)["frame"]) == (True, 4)


def test_a_report_is_one_that_was_drawn_here(
    label_server: Server, clicking: Clicking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, drawn = clicking.project, list[Path]()
    result = project.labelling.out / "results" / project._grasp(clicking.about).name
    where = "&".join(f"{key}={value}" for key, value in clicking.about.items())

    def draw(folder: Path, job: object) -> str:
        drawn.append(folder)
        for name in jobs.REPORT_FILES:
            (folder / name).unlink(missing_ok=True)  # a link is replaced
            (folder / name).write_text("ours")
        return ""

    monkeypatch.setattr(jobs, "draw_report", draw)
    assert ask(label_server, f"/report.html?{where}")[0] == 409
    assert not result.exists()
    result.mkdir(parents=True)
    (result / "result.json").touch()
    (result / "report.html").write_text("<script>a stranger's</script>")
    (tmp_path / "secret").write_text("secret")
    (result / "report.png").symlink_to(tmp_path / "secret")
    for name in ("report.html", "report.png", "report.html"):
        status, head, content = ask(label_server, f"/{name}?{where}")
        assert (status, content) == (200, b"ours")
        assert "sandbox allow-scripts" in head["Content-Security-Policy"]
        assert "allow-same-origin" not in head["Content-Security-Policy"]
    assert drawn == [result]
    result.rename(tmp_path / "moved")
    result.symlink_to(tmp_path / "moved")
    assert ask(label_server, f"/report.html?{where}")[0] == 400


@pytest.mark.slow
def test_hostile_clicks_over_http_are_answered_in_words(label_server: Server, clicking: Clicking) -> None:
    many = {"outlines": {"the-disc": {"of": "object", "closed": True, "points": [[1, 1]] * 10**6}}}
    body = json.dumps(clicking.change(4, {"joints": {"0": [1, 2]}}))
    bodies = {
        json.dumps(clicking.change(4, many)): 400, body.replace("[1, 2]", "[NaN, 1e999]"): 409,
        body.replace("[1, 2]", "[" * 40_000 + "]" * 40_000): 400, body.replace("[1, 2]", '"' + "x" * 60_000 + '"'): 409,
        body.replace("[1, 2]", "[1" + "0" * 5000 + ", 2]"): 400, body[:-1]: 400,
    }  # fmt: skip
    for text, expected in bodies.items():
        status, head, answer = ask(label_server, "/api/label", text.encode())
        assert (status, head["Content-Type"]) == (expected, "application/json")
        assert len(answer) < 1000
    assert len(json.dumps(many)) > MAX_BODY_BYTES
    for path, content in (
        ("/api/work", {"work": "rm"}),
        ("/api/work", {"work": {}}),
        ("/api/label", {}),
        ("/api/unlabel", {}),
    ):
        assert ask(label_server, path, clicking.about | content)[0] == 409
    for path in ("/api/labels", "/api/drafts", "/labels.json", "/api/drafts?since=-1"):
        assert ask(label_server, path)[0] in (400, 409)
    assert clicking.state()["newest"] == 0
