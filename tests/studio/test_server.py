"""The server of the page: frames and marks, for those with the token on this machine only."""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from getagrip.cli.annotate import MARKS_DATABASE
from getagrip.errors import UsageError
from getagrip.studio.project import Project
from getagrip.studio.server import MAX_BODY_BYTES, StudioServer, persistent_token, serve_on_free_port
from getagrip.studio.store.mark_store import MarkStore
from getagrip.studio.store.tasks import Task
from helpers.annotation import MARKED_VIDEO, ask, change, new
from helpers.environment import Run
from helpers.labelled_scene import NUMBERED_FRAMES, number_in, write_images


@pytest.fixture
def server(project: Project) -> Iterator[StudioServer]:
    with StudioServer(project, 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def test_frames_and_marks_over_http(server: StudioServer) -> None:
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


def test_the_page_is_for_this_machine_only(server: StudioServer) -> None:
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


def test_the_address_with_the_token_opens_the_page(server: StudioServer) -> None:
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


def test_another_port_is_taken_where_the_usual_one_is_not_free(project: Project, monkeypatch: Any) -> None:
    with StudioServer(project, 0) as busy:
        monkeypatch.setattr("getagrip.studio.server.DEFAULT_PORT", busy.server_port)
        with serve_on_free_port(project, "a-token") as other:
            assert other.server_port != busy.server_port
        with pytest.raises(UsageError, match="--port"):
            StudioServer(project, busy.server_port)


@pytest.mark.parametrize(
    ("path", "content", "expected"),
    [
        ("/frame?task=nothing&n=0", None, 409), (f"/frame?task={MARKED_VIDEO}&n=70", None, 409),
        (f"/frame?task={MARKED_VIDEO}&n=-1", None, 400), (f"/frame?task={MARKED_VIDEO}", None, 400), ("/frame", None, 400),
        ("/../cli.py", None, 404), ("/page.js/../store.py", None, 404), ("/api/marks", None, 409),
        ("/api/tasks?annotator=..%2Fx", None, 409), ("/grasps.csv?annotator=", None, 409),
        ("/api/change", b"{", 400), ("/api/change", b"[]", 400), ("/api/change", b"[" * 60_000, 400),
        ("/api/change", b"\xff\xfe", 400), ("/api/change", {}, 409), ("/api/undo", {}, 409), ("/api/other", {}, 404),
        ("/api/change", b" " * (MAX_BODY_BYTES + 1), 400),
    ],
)  # fmt: skip
def test_bad_requests_are_answered_in_words(server: StudioServer, path: str, content: object, expected: int) -> None:
    status, head, answer = ask(server, path, content)
    assert (status, head["Content-Type"]) == (expected, "application/json")
    assert set(json.loads(answer)) == {"error"}


def test_forms_of_other_sites_cannot_be_sent(server: StudioServer) -> None:
    """A form can be sent across sites without asking; JSON cannot."""
    head = {"Content-Type": "text/plain"}
    assert ask(server, "/api/change", change(new(), {"start": 1}), head)[0] == 400


def test_a_database_that_cannot_be_written_is_reported(server: StudioServer) -> None:
    other = sqlite3.connect(server.project.store.path)
    server.project.store.database.connection.execute("PRAGMA busy_timeout = 50")
    other.execute("BEGIN EXCLUSIVE")
    sent = change(new(), {"start": 4})
    assert ask(server, "/api/change", sent)[0] == 503
    other.execute("ROLLBACK")
    other.close()
    assert ask(server, "/api/change", sent)[0] == 200


def test_a_port_in_use_is_reported(server: StudioServer, video: Path, run: Run, tmp_path: Path) -> None:
    status, _, err = run("annotate", video, "--out", tmp_path / "other", "--port", server.server_port)
    assert status == 2
    assert "--port" in err


def test_a_folder_of_images_is_served(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "P01_01", [7, 8, 9])
    project = Project([Task("P01_01", "P01_01", folder)], MarkStore(tmp_path / MARKS_DATABASE))
    image, _, number = project.frame("P01_01", 2)
    assert (number_in(image), number) == (9, 9)
    project.close()
