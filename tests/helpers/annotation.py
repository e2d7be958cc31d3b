"""A browser without a window, where there is one on the machine.

One who clicks: changes of a video's labels as the page sends them.

Marks as the page makes them.

The annotation page: a server that can be stopped and started again, and requests to it.

Labelling in a browser as a person does it: a tab, clicks on points of the footage, what is kept of them.
"""

from __future__ import annotations

import http.client
import json
import shutil
import threading
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.readers.masks.mask_regions import fill_polygons
from getagrip.studio.project import Project
from getagrip.studio.server import Server
from getagrip.studio.store.labels import KeyFrame
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.tasks import Task
from helpers.environment import needs_library
from helpers.labelled_scene import HEIGHT, WIDTH, circle, joints

VIDEO = "scene"


FIRST, LAST = 2, 9


TAB = "tab-one-"


def new() -> str:
    return str(uuid.uuid4())


class Clicking:
    """A project, and a grasp that somebody labels in it."""

    def __init__(self, video: Path, folder: Path, who: str = "ann") -> None:
        self.project = Project([Task(VIDEO, VIDEO, video)], Store(folder / DATABASE))
        self.about = {"task": VIDEO, "annotator": who, "grasp": new()}
        start = {"start": FIRST, "side": "left", "category": "disc"}
        for sets in (start, {"end": LAST}):
            self.project.change(self.about | {"change": new(), "mark": self.about["grasp"], "tab": TAB, "set": sets})

    def change(self, frame: int, sets: object, tab: str = TAB) -> dict[str, Any]:
        return self.about | {"change": new(), "tab": tab, "frame": frame, "set": sets}

    def click(self, frame: int, tab: str = TAB, **sets: Any) -> dict[str, Any]:
        return self.project.label(self.change(frame, sets, tab))

    def undo(self, tab: str = TAB) -> dict[str, Any]:
        return self.project.unlabel(self.about | {"change": new(), "tab": tab})

    def state(self) -> dict[str, Any]:
        return self.project.labels(self.about)

    def labels(self) -> list[dict[str, Any]]:
        return self.state()["keyframes"]

    def label(self, frame: int) -> None:
        """All that there is to be clicked on a frame."""
        self.click(frame, joints={str(n): point for n, point in enumerate(joints(frame))}, outlines=disc(frame))

    def work(self, what: str, **about: Any) -> dict[str, Any]:
        """Have something done; the job once it is over."""
        self.project.work(self.about | {"work": what} | about)
        job = self.project.labelling.background.job(self.about["grasp"])
        assert job is not None
        for _ in range(3000):
            if job.state not in ("waiting", "running"):
                break
            time.sleep(0.02)
        return dict(self.state()["job"])


def disc(frame: int, closed: bool = True) -> dict[str, Any]:
    return {"the-disc": {"of": "object", "closed": closed, "points": circle(frame)}}


def filled(outlines: list[Any], size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    flat = [np.ravel(shape).tolist() for shape in outlines]
    return fill_polygons(Path(), "", flat, size)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


MARKED_VIDEO = "P01_101"


def change(
    mark: str, sets: dict[str, Any], who: str = "ann", task: str = MARKED_VIDEO, tab: str = "tab-one-"
) -> dict[str, Any]:
    return {"change": new(), "mark": mark, "task": task, "annotator": who, "tab": tab, "set": sets}


def undo(who: str = "ann", task: str = MARKED_VIDEO, tab: str = "tab-one-") -> dict[str, Any]:
    return {"change": new(), "task": task, "annotator": who, "tab": tab}


def grasp(project: Project, start: int, end: int, who: str = "ann", task: str = MARKED_VIDEO, **more: Any) -> str:
    mark = new()
    project.change(change(mark, {"start": start, "side": "left", "category": "mug", **more}, who, task))
    project.change(change(mark, {"end": end}, who, task))
    return mark


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE = 30_000
"""What is expected of a page may take so long [ms]."""
IN_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
    needs_library("playwright"),
]
"""Marks of tests that use it."""
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing")
"""Arguments with which it renders WebGL without a graphics card, and all else without WebGL."""
FEW_PROCESSES = ("--renderer-process-limit=1", "--disable-site-isolation-trials")
READS_BACK = "GPU stall due to ReadPixels"
"""What it warns of then."""


class Chromium:
    """One browser for all tests of a process, as it takes long to start, and another once it or its driver has died."""

    def __init__(self) -> None:
        self._started: Any = None
        self._browser: Any = None

    def get(self) -> Any:
        """The browser that answers, with patience for a page on a busy machine."""
        from playwright.sync_api import Error, expect, sync_playwright

        if self._browser is not None:
            try:
                self._browser.new_context().close()
            except Error:
                self.close()
        if self._browser is None:
            expect.set_options(timeout=PATIENCE)
            self._started = sync_playwright().start()
            arguments = ["--no-sandbox", *WEBGL, *FEW_PROCESSES]
            try:
                self._browser = self._started.chromium.launch(executable_path=CHROMIUM, args=arguments)
            except Error:
                self.close()
                raise
        return self._browser

    def close(self) -> None:
        """End the browser and its driver, whether or not they still live."""
        from playwright.sync_api import Error

        started, browser, self._started, self._browser = self._started, self._browser, None, None
        with suppress(Error):
            if browser is not None:
                browser.close()
        if started is not None:
            started.stop()


def close(profile: Any) -> None:
    """Close a profile, unless the browser has died since a test's end: the next one gets another."""
    from playwright.sync_api import Error

    with suppress(Error):
        profile.close()


def expect(it: Any) -> Any:
    """Playwright's assertions, which wait until they hold."""
    from playwright.sync_api import expect

    return expect(it)


def until(page: Any, condition: str) -> None:
    """Wait for JavaScript that says true. (Playwright's own wait compiles it in the page, which the page forbids.)"""
    for _ in range(PATIENCE // 50):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never true: {condition}")


class Served:
    """A server that can be stopped and started again on the same port and file."""

    def __init__(self, tasks: list[Task], database: Path) -> None:
        self.tasks, self.database, self.port = tasks, database, 0
        self.start()

    def start(self) -> None:
        self.project = Project(self.tasks, Store(self.database))
        self.server = Server(self.project, self.port, "a-token")
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
    server: Server, path: str, content: object = None, head: dict[str, str] | None = None
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


FIRST_FRAME, BETWEEN, LAST_FRAME = 2, 4, 6
MARK = "the-marked-grasp"


def opened(context: Any, served: Served, who: str | None = "ann") -> Any:
    """A tab that labels the grasp, its first frame on the screen."""
    page = context.new_page()
    page.on("pageerror", lambda error: pytest.fail(f"the page raised {error}"))
    page.set_default_timeout(10_000)
    page.goto(f"{served.server.url}#scene")
    if who is not None:
        page.fill("#name-field", who)
        page.keyboard.press("Enter")
    page.get_by_role("button", name="Label", exact=True).click()
    shows(page, FIRST_FRAME)
    return page


def shows(page: Any, frame: int) -> None:
    expect(page.locator("#frame")).to_have_text(str(frame + 1))
    until(page, "!document.getElementById('waiting').classList.contains('on')")


def goto(page: Any, frame: int) -> None:
    now = int(page.inner_text("#frame")) - 1
    for _ in range(abs(frame - now)):
        page.keyboard.press("ArrowRight" if frame > now else "ArrowLeft")
    shows(page, frame)


def on_screen(page: Any, point: Sequence[float]) -> tuple[float, float]:
    """Where a point of the footage is on the screen."""
    matrix = page.evaluate("(() => { const m = layer.getScreenCTM(); return [m.a, m.e, m.f]; })()")
    return matrix[0] * point[0] + matrix[1], matrix[0] * point[1] + matrix[2]


def click(page: Any, point: Sequence[float]) -> None:
    page.mouse.click(*on_screen(page, point))


def drag(page: Any, start: Sequence[float], end: Sequence[float]) -> None:
    page.mouse.move(*on_screen(page, start))
    page.mouse.down()
    page.mouse.move(*on_screen(page, end), steps=4)
    page.mouse.up()


def kept(served: Served) -> dict[int, KeyFrame]:
    return {one.frame: one for one in served.project.store.keyframes.standing(MARK)}


def near(found: Any, wanted: Sequence[float], within: float = 0.6) -> bool:
    return bool(np.abs(np.array(found) - wanted).max() < within)


def draw(page: Any, points: list[list[float]]) -> None:
    for point in points:
        click(page, point)
    page.keyboard.press("Enter")


def draw_disc(page: Any, frame: int) -> None:
    page.keyboard.press("o")
    draw(page, circle(frame, 8))


def click_joints(page: Any, frame: int) -> None:
    """All of them, closer up so that no two are one."""
    page.keyboard.press("j")
    page.keyboard.press("+")
    for point in joints(frame):
        click(page, point)
    page.keyboard.press("0")
