"""The annotation page: a server that can be stopped and started again, and requests to it."""

from __future__ import annotations

import http.client
import json
import threading
from pathlib import Path
from typing import Any

from getagrip.studio.project import Project
from getagrip.studio.server import StudioServer
from getagrip.studio.store.mark_store import MarkStore
from getagrip.studio.store.tasks import Task
from helpers.browser import expect


class Served:
    """A server that can be stopped and started again on the same port and file."""

    def __init__(self, tasks: list[Task], database: Path) -> None:
        self.tasks, self.database, self.port = tasks, database, 0
        self.start()

    def start(self) -> None:
        self.project = Project(self.tasks, MarkStore(self.database))
        self.server = StudioServer(self.project, self.port, "a-token")
        self.port = self.server.server_port
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.02})
        self.thread.start()

    def stop(self) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()
        self.project.close()

    def grasps(self) -> list[tuple[Any, ...]]:
        return [(mark.start, mark.end, mark.side, mark.category) for mark in self.project.store.marks.standing()]


def ask(
    server: StudioServer, path: str, content: object = None, head: dict[str, str] | None = None
) -> tuple[int, dict[str, str], bytes]:
    """GET, or POST where there is content."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    body = content if content is None or isinstance(content, bytes) else json.dumps(content).encode()
    kind = {"Content-Type": "application/json"} if body is not None else {}
    kind |= {"Cookie": f"{server.cookie}={server.token}"}
    connection.request("GET" if body is None else "POST", path, body, kind | (head or {}))
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return found


def saved(page: Any) -> None:
    """Wait until the server has everything."""
    expect(page.locator("#saved")).to_have_text("All saved")
