"""Labelling in a browser as a person does it: a tab, clicks on points of the footage, what is kept of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from getagrip.studio.store.labels import KeyFrame
from helpers.annotation_page import Served
from helpers.browser import expect, until
from helpers.labelled_scene import circle, joints

FIRST, BETWEEN, LAST = 2, 4, 6
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
    shows(page, FIRST)
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
