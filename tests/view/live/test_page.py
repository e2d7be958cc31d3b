"""The page without a browser: what is asked for is shown in the nodes of the scene."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.view.gap import gap
from getagrip.view.live import standing
from getagrip.view.live.column import Column
from getagrip.view.live.entries import Entry
from getagrip.view.live.page import Page
from getagrip.view.live.panel import Heard
from getagrip.view.live.server import Served, serve
from getagrip.view.live.stage import Look
from helpers.needs import needs
from helpers.two_candidates import column, two_candidates

pytestmark = [pytest.mark.slow, needs("viser", "view")]


class Listed(Entry):
    """An entry that is in memory."""

    def read(self) -> list[Column]:
        _, clip, masks = two_candidates()
        if self.label == "broken":
            raise InputError("result.json", "clip", "nothing", "a clip")
        if self.label == "clip":
            return [Column.of_clip(replace(clip, truth=None), masks)]
        return [column(), column().candidate(1)] if self.label == "two" else [column()]


class Running:
    """A page in a thread of its own."""

    def __init__(self, served: Served) -> None:
        entries = [Listed(label) for label in ("one", "two", "clip", "broken")]
        self.page = Page(served.viser, entries, entries[0].read())
        self.heard: Heard = self.page._panel._heard
        self.thread = threading.Thread(target=self.page.run)
        self.thread.start()

    def pose(self, part: str, k: int = 0) -> np.ndarray:
        node = self.page._actors[k].stage._nodes[part]
        return se3.rigid(se3.from_quaternion(np.array(node.wxyz)), np.array(node.position))

    def until(self, true: Callable[[], bool]) -> None:
        for _ in range(200):
            if true():
                return
            time.sleep(0.02)
        raise AssertionError


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    made = serve()
    yield made
    made.stop()


@pytest.fixture
def running(served: Served) -> Iterator[Running]:
    made = Running(served)
    yield made
    made.page.stop()
    made.thread.join()


def test_frames_and_candidates_are_shown_where_they_are(running: Running) -> None:
    it = column()
    for n, rank in ((0, 0), (3, 0), (3, 1)):
        running.heard.frame(n)
        running.heard.candidate(0, rank)
        shown = it.candidate(rank)
        expected = standing.T_scene_cam(shown, "hand")[n] @ shown.T_cam_obj[n]
        running.until(lambda expected=expected: bool(np.allclose(running.pose("object"), expected, atol=1e-5)))  # type: ignore[misc]
    running.heard.look(Look(frozenset({"hand", "object"}), still="object"))
    middle = it.candidate(1).T_cam_obj[len(it.view.clip) // 2]
    running.until(lambda: bool(np.allclose(running.pose("object"), middle, atol=1e-5)))
    nodes = running.page._actors[0].stage._nodes
    running.until(lambda: not nodes["axis"].visible and not nodes["true object"].visible)  # one after the other
    assert nodes["hand"].visible


def test_what_is_measured_appears_in_time(running: Running) -> None:
    running.heard.candidate(0, 1)
    running.until(lambda: running.page._actors[0].column.rank == 1)
    (actor,) = running.page._actors
    running.until(lambda: bool(np.isfinite(actor.gap).all() and np.isfinite(actor.iou).all()))
    assert actor.iou.mean() < 0.7
    np.testing.assert_allclose(actor.gap, gap(column().candidate(1).view))  # as the report has it
    running.until(lambda: len(running.page._known[0]) == 2)
    running.until(lambda: "Speaks against it" in running.page._panel._compared[0].content)


def test_it_plays_and_steps_come_round(running: Running) -> None:
    running.heard.step(-1)
    running.until(lambda: running.page._player.frame == 4)
    running.heard.speed(2.0)
    running.heard.play()
    running.until(lambda: running.page._player.frame != 4)
    running.heard.step(1)
    running.until(lambda: not running.page._player.playing)


def test_other_entries_take_the_first_ones_place_and_broken_ones_do_not(running: Running) -> None:
    running.heard.entry(1)
    running.until(lambda: len(running.page._actors) == 2 and running.page._actors[1].column.rank == 1)
    running.until(lambda: running.pose("hand", 1)[0, 3] > running.pose("hand", 0)[0, 3] + 0.03)
    running.heard.entry(2)
    running.until(lambda: len(running.page._actors) == 1 and not running.page._actors[0].column.posed)
    assert "object" not in running.page._actors[0].stage._nodes
    running.heard.entry(3)
    running.heard.frame(2)
    running.until(lambda: running.page._player.frame == 2)
    assert not running.page._actors[0].column.posed
