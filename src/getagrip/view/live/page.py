"""The page: what is open, what is shown of it, and the thread that alone changes it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from queue import Empty, Queue
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.geometry import se3
from getagrip.view.curves import seconds
from getagrip.view.live import evidence, overlay, standing
from getagrip.view.live.actor import Actor, plots
from getagrip.view.live.column import Column
from getagrip.view.live.entries import Entry
from getagrip.view.live.panel import Heard, Panel
from getagrip.view.live.player import Player
from getagrip.view.live.plots import COLOURS
from getagrip.view.live.stage import Look

if TYPE_CHECKING:
    from viser import ViserServer

FIELD = np.radians(45.0)
"""Vertical field of view at first."""
ASIDE = np.radians([-16.0, 24.0])
"""At first one looks from so far above and beside the camera: from the camera itself depth is hard to see."""
ENDING = 5.0
"""What is being measured may take so long to end [s]."""
NARROW = 0.85
"""Width by height of what the panels leave to the scene, on common screens."""
APART = 1.15
"""Columns stand so many of their widths apart."""


class Page:
    """Entries on a server, one of them open.

    viser calls back in threads of its own. They only queue what is to be done; ``run`` does it, one after another, and
    draws what has changed when nothing is left to do.
    """

    def __init__(self, server: ViserServer, entries: Sequence[Entry], first: Sequence[Column]) -> None:
        """Open columns that have been read from the first entry."""
        self._server, self._entries = server, entries
        self._jobs: Queue[Callable[[], None] | None] = Queue()
        self._look, self._player = Look(), Player(np.zeros(1))
        self._actors: list[Actor] = []
        self._known: list[list[evidence.Numbers]] = []
        self._opened = 0
        heard = Heard(
            frame=lambda n: self._later(lambda: self._player.go(n)),
            step=lambda by: self._later(lambda: self._step(by)),
            play=lambda: self._later(self._play),
            speed=lambda speed: self._later(lambda: setattr(self._player, "speed", speed)),
            look=lambda look: self._later(lambda: setattr(self, "_look", look)),
            candidate=lambda k, rank: self._later(lambda: self._candidate(k, rank)),
            entry=lambda n: self._later(lambda: self._entry(n)),
            through_camera=lambda: self._later(self._through_camera),
        )
        server.scene.configure_default_lights(cast_shadow=False)  # slow without a graphics card
        self._panel = Panel(server, heard, [entry.label for entry in entries])
        self._open(first)
        self._draw()

    def run(self) -> None:
        """Do what is asked for until ``stop``."""
        since, left = time.monotonic(), 0.0
        while True:
            wait = max(self._player.duration - left, 0.0) if self._player.playing else None
            try:
                job = self._jobs.get(timeout=wait)
                if job is None:
                    return
                job()
            except Empty:
                pass
            now = time.monotonic()
            left = self._player.late(left + now - since) if self._player.playing else 0.0
            since = now
            if self._jobs.empty():
                self._draw()

    def stop(self) -> None:
        """End ``run``, and what is being measured."""
        self._opened += 1
        self._jobs.put(None)
        self._measuring.join(ENDING)

    def _later(self, job: Callable[[], None]) -> None:
        self._jobs.put(job)

    def _draw(self) -> None:
        """Show the player's frame."""
        n, view = self._player.frame, self._actors[0].column.view
        pictures = [actor.overlays.picture(n, "truth" in self._look.parts) for actor in self._actors]
        text = f"{view.result.frames[n]}, at {self._player.time[n]:.2f} s, {view.result.frame_kind[n]}"
        with self._server.atomic():
            for actor in self._actors:
                actor.stage.show(n, self._look)
            self._panel.frame(n, text, self._together(pictures), plots(self._actors))

    def _together(self, pictures: list[UInt8[ndarray, "size size 3"]]) -> UInt8[ndarray, "H W 3"]:
        """The columns' pictures, laid out as the columns are."""
        return overlay.side_by_side(pictures, [actor.colour for actor in self._actors], _across(len(pictures)))

    def _step(self, by: int) -> None:
        self._player.playing = False
        self._panel.playing(False)
        self._player.go(self._player.frame + by)

    def _play(self) -> None:
        self._player.playing = not self._player.playing
        self._panel.playing(self._player.playing)

    def _entry(self, n: int) -> None:
        """Open another entry; where it cannot be read, an error is shown and the former one stays."""
        try:
            columns = self._entries[n].read()
        except (GetagripError, OSError) as error:
            for client in self._server.get_clients().values():
                client.add_notification("This cannot be shown", str(error), color="red", auto_close_seconds=None)
            return
        self._open(columns)

    def _open(self, columns: Sequence[Column]) -> None:
        """Show other columns."""
        for actor in self._actors:
            actor.stage.remove()
        self._server.scene.reset()
        up = standing.up(columns[0])
        self._server.scene.set_up_direction(up)
        choices = standing.choices(columns)
        if self._look.still not in choices:
            self._look = replace(self._look, still=choices[0])
        self._player = Player(seconds(columns[0].view))
        low, high = _extent(columns)
        self._beside = _places(low, high, len(columns))
        self._actors = [
            Actor(self._server.scene, f"column{k}", column, self._beside[k], COLOURS[k % len(COLOURS)])
            for k, column in enumerate(columns)
        ]
        self._columns = list(columns)
        self._known = [[] for _ in columns]
        if len(columns) > 1:
            for k, column in enumerate(columns):
                top = np.array([(low[0] + high[0]) / 2, low[1] - 0.1 * (high - low)[1], (low[2] + high[2]) / 2])
                self._server.scene.add_label(f"/name{k}", column.name, position=top + self._beside[k])
        self._panel.open(columns, choices, self._look)
        self._panel.names(columns)
        self._look_at((low + high) / 2 + np.mean(self._beside, axis=0), high - low, len(columns), up)
        self._measure()

    def _candidate(self, k: int, rank: int) -> None:
        """Show another candidate in column ``k``."""
        former = self._actors[k]
        former.stage.remove()
        column = self._columns[k].candidate(rank)
        self._actors[k] = Actor(self._server.scene, f"column{k}", column, self._beside[k], former.colour)
        self._panel.compared(k, self._known[k], rank)
        self._measure()

    def _measure(self) -> None:
        """Measure what takes time, in a thread of its own, and show it once known; former measuring ends."""
        self._opened += 1
        opened, actors = self._opened, list(self._actors)

        def go_on() -> bool:
            return opened == self._opened

        def know(k: int, known: list[evidence.Numbers]) -> None:
            if go_on():
                self._known[k] = known
                self._panel.compared(k, known, actors[k].column.rank)

        def work() -> None:
            for actor in actors:
                actor.measure(go_on)
                self._later(lambda: None)  # draw the curves
            for k, actor in enumerate(actors):
                if go_on() and actor.column.is_result and not self._known[k]:
                    known = evidence.numbers(actor.column)
                    self._later(lambda k=k, known=known: know(k, known))  # type: ignore[misc]

        self._measuring = threading.Thread(target=work, daemon=True)
        self._measuring.start()

    def _look_at(
        self, centre: Float[ndarray, "3"], size: Float[ndarray, "3"], count: int, up: Float[ndarray, "3"]
    ) -> None:
        """Let all who watch, and who will, look at so many columns of a size in the scene [m]."""
        rows = -(-count // _across(count))
        wide = max(size[0], size[2]) * _across(count) / NARROW
        span = APART * float(max(wide, size[1] * rows))
        away = 0.55 * span / np.tan(FIELD / 2.0) + size[2] / 2.0
        position = centre - away * _view_axes()[2]
        start = self._server.initial_camera
        start.fov, start.up, start.position, start.look_at = FIELD, up, position, centre
        for client in self._server.get_clients().values():
            client.camera.fov, client.camera.position, client.camera.look_at = FIELD, position, centre

    def _through_camera(self) -> None:
        """Look at the first column as the camera does in this frame."""
        column, n = self._actors[0].column, self._player.frame
        T = standing.T_scene_cam(column, self._look.still)[n]
        K, (_, height) = column.view.clip.K[n], column.view.clip.size
        far = T @ np.array([0.0, 0.0, float(np.linalg.norm(column.T_cam_hand[n, :3, 3])), 1.0])
        for client in self._server.get_clients().values():
            client.camera.fov = 2.0 * float(np.arctan(height / 2.0 / K[1, 1]))
            client.camera.wxyz, client.camera.position = se3.quaternion(T[:3, :3]), T[:3, 3]
            client.camera.look_at = far[:3]


def _across(count: int) -> int:
    """How many of so many columns stand beside each other, in the scene and among the pictures."""
    return min(2, count)


def _view_axes() -> Float[ndarray, "3 3"]:
    """Right, down and forward, one a row, as one looks at the scene at first."""
    turn = se3.exp_so3(np.array([0.0, ASIDE[1], 0.0])) @ se3.exp_so3(np.array([ASIDE[0], 0.0, 0.0]))
    return np.asarray(turn.T)


def _places(low: Float[ndarray, "3"], high: Float[ndarray, "3"], count: int) -> list[Float[ndarray, "3"]]:
    """How far each column is moved [m], so that boxes stand in rows, across the direction in which one looks."""
    size, (right, down, _) = APART * (high - low), _view_axes()
    across = _across(count)
    return [(k % across) * max(size[0], size[2]) * right + (k // across) * size[1] * down for k in range(count)]


def _extent(columns: Sequence[Column]) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]]:
    """The box around the middle frame of all columns, in the camera frame [m]."""
    n = len(columns[0].view.result.frames) // 2
    points = [column.view.hand(n) for column in columns]
    points += [column.view.object(n) for column in columns if column.posed]
    both = np.concatenate(points)
    return both.min(axis=0), both.max(axis=0)
