"""A server that can be stopped and started again, and a browser, for the tests of the annotation page."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from getagrip.annotate.project import Project
from getagrip.annotate.server import Server
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import Task

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Served:
    """A server that can be stopped and started again on the same port and file."""

    def __init__(self, tasks: list[Task], database: Path) -> None:
        self.tasks, self.database, self.port = tasks, database, 0
        self.start()

    def start(self) -> None:
        self.project = Project(self.tasks, Store(self.database))
        self.server = Server(self.project, self.port)
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


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def saved(page: Any) -> None:
    """Wait until the server has everything."""
    from playwright.sync_api import expect

    expect(page.locator("#saved")).to_have_text("All saved")


def until(page: Any, said: str) -> None:
    """Wait for JavaScript that says true. (Playwright's own wait compiles it in the page, which the page forbids.)"""
    for _ in range(200):
        if page.evaluate(said):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never true: {said}")
