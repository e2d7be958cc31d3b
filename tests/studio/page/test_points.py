"""Points and strokes in a real browser: clicked, dragged, corrected, reloaded, where the picture shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.annotation import (
    FIRST_FRAME,
    IN_BROWSER,
    LAST_FRAME,
    Served,
    click,
    drag,
    draw,
    draw_disc,
    expect,
    kept,
    near,
    on_screen,
    opened,
    saved,
    shows,
)
from helpers.labelled_scene import circle, joints, middle

pytestmark = IN_BROWSER


def test_joints_are_clicked_in_order_corrected_and_not_lost(context: Any, served: Served) -> None:
    page, points = opened(context, served), joints(FIRST_FRAME)
    expect(page.locator("#joint")).to_have_text("Next: Wrist")
    click(page, points[0])
    expect(page.locator("#joint")).to_have_text("Next: Thumb root, at the wrist")
    page.keyboard.press("m")
    click(page, points[2])
    expect(page.locator("#joint")).to_have_text("Next: Thumb last joint")
    saved(page)
    state = kept(served)[FIRST_FRAME].joints
    assert state["1"] == "unseen"
    assert near(state["0"], points[0])
    assert near(state["2"], points[2])
    drag(page, points[0], [100, 200])
    saved(page)
    assert near(kept(served)[FIRST_FRAME].joints["0"], [100, 200])
    for _ in range(3):
        page.keyboard.press("d")  # a pixel of the screen to the right, the wrist being chosen
    page.keyboard.press("w")
    page.reload()  # what was not sent yet goes first
    shows(page, FIRST_FRAME)
    saved(page)
    x, y = kept(served)[FIRST_FRAME].joints["0"]
    assert 100.5 < x < 102
    assert 199 < y < 200
    page.locator("#hand circle").nth(2).click()  # chosen in the picture of the hand
    expect(page.locator("#joint-chosen")).to_have_text("Chosen: Thumb knuckle")
    page.keyboard.press("Delete")
    expect(page.locator("#joint")).to_have_text("Next: Thumb knuckle")
    for _ in range(10):
        page.keyboard.press("u")
    expect(page.locator("#keyframes li")).to_have_count(0)
    saved(page)
    assert kept(served) == {}
    assert len(served.grasps()) == 1


def test_joints_that_are_not_visible_are_not_called_there(context: Any, served: Served) -> None:
    page = opened(context, served)
    click(page, joints(FIRST_FRAME)[0])
    for _ in range(20):
        page.keyboard.press("m")
    expect(page.locator("#joint")).to_have_text("Nothing is left to click here: 20 joints are not visible.")


def test_a_polygon_is_drawn_closed_and_edited(context: Any, served: Served) -> None:
    page, points = opened(context, served), circle(FIRST_FRAME, 8)
    page.keyboard.press("o")
    for point in points:
        click(page, point)
    saved(page)
    (outline,) = kept(served)[FIRST_FRAME].outlines.values()
    assert not outline["closed"]
    page.reload()  # in the middle of it
    shows(page, FIRST_FRAME)
    page.keyboard.press("o")
    click(page, points[0])
    saved(page)
    (outline,) = kept(served)[FIRST_FRAME].outlines.values()
    assert outline["closed"]
    assert near(outline["points"], points)
    half = (np.array(points[0]) + points[1]) / 2
    click(page, half.tolist())  # on the line: a point more
    drag(page, points[3], [60, 60])
    saved(page)
    (outline,) = kept(served)[FIRST_FRAME].outlines.values()
    assert near(outline["points"], [points[0], half.tolist(), *points[1:3], [60, 60], *points[4:]])
    page.keyboard.press("Delete")  # the point that was dragged
    page.keyboard.press("i")
    draw(page, circle(FIRST_FRAME + 8, 5))
    saved(page)
    assert [len(shape) for shape in kept(served)[FIRST_FRAME].polygons("object")] == [8]
    assert [len(shape) for shape in kept(served)[FIRST_FRAME].polygons("front")] == [5]
    expect(page.locator("#outline-list li")).to_have_count(2)
    page.locator("#outline-list li.front button").click()
    saved(page)
    assert not kept(served)[FIRST_FRAME].polygons("front")


def test_points_are_placed_where_the_zoomed_and_moved_picture_shows_them(context: Any, served: Served) -> None:
    page = opened(context, served)
    x, y = on_screen(page, [150, 90])
    page.mouse.move(x, y)
    page.mouse.wheel(0, -900)
    expect(page.locator("#zoom")).not_to_have_text("100 %")
    assert near(on_screen(page, [150, 90]), [x, y], 3.0)  # what is under the mouse stays there
    drag(page, [150, 90], [160, 95])  # nothing is there to be moved: the picture is
    assert kept(served) == {}
    click(page, [151.25, 90.5])
    saved(page)
    assert near(kept(served)[FIRST_FRAME].joints["0"], [151.25, 90.5], 0.2)


def test_clicks_near_points_add_points(context: Any, served: Served) -> None:
    """Every click while drawing is a point, however near; later a click on a line inserts one, on a dot selects it."""
    page = opened(context, served)
    page.keyboard.press("o")
    border = [[100 + 4 * n, 80] for n in range(8)] + [[128, 120], [100, 120]]
    x, y = on_screen(page, border[0])
    step = on_screen(page, border[1])[0] - x
    assert step < 8 * 4  # nearer to each other than a click reaches
    draw(page, border)
    saved(page)
    (one,) = kept(served)[FIRST_FRAME].outlines.values()
    assert (len(one["points"]), one["closed"]) == (len(border), True)
    page.mouse.click(*on_screen(page, [130, 120]))  # beside the dot, not on it
    page.mouse.click(x, y)
    saved(page)
    (one,) = kept(served)[FIRST_FRAME].outlines.values()
    assert len(one["points"]) in (len(border), len(border) + 1)
    assert page.locator("#layer .corner.chosen").count() == 1


def test_an_answer_that_comes_late_takes_nothing_back(context: Any, served: Served) -> None:
    page, points, late = opened(context, served), circle(FIRST_FRAME, 8), []
    page.route("**/api/labels*", lambda route: route.continue_() if late else late.append((route, route.fetch())))
    while not late:  # the page has asked, and waits
        page.wait_for_timeout(50)
    draw_disc(page, FIRST_FRAME)
    saved(page)
    route, answer = late[0]
    route.fulfill(response=answer)
    page.wait_for_timeout(200)
    half = (np.array(points[0]) + points[1]) / 2
    click(page, half.tolist())
    saved(page)
    (outline,) = kept(served)[FIRST_FRAME].outlines.values()
    assert near(outline["points"], [points[0], half.tolist(), *points[1:]])


@pytest.mark.slow
def test_strokes_are_kept_and_masks_follow_at_once(context: Any, served: Served) -> None:
    page = opened(context, served)
    page.keyboard.press("q")
    x, y = middle(FIRST_FRAME).tolist()
    drag(page, (x - 20, y), (x + 20, y + 5))
    expect(page.locator("#fill-state")).to_have_text(f"All {LAST_FRAME - FIRST_FRAME + 1} frames filled in.")
    expect(page.locator("#layer .draft.object")).to_have_count(1)
    page.keyboard.press("z")
    click(page, (x - 90, y))
    saved(page)
    shapes = sorted(one["of"] for one in kept(served)[FIRST_FRAME].outlines.values())
    assert shapes == ["off", "on"]
    expect(page.locator("#layer .stroke")).to_have_count(2)
    page.keyboard.press("u")
    expect(page.locator("#layer .stroke")).to_have_count(1)
