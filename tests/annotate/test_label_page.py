"""Labelling in a real browser: click joints, draw, fill in, correct, reload, nothing lost; two tabs at once."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.annotate import propagated_masks, reconstruction
from getagrip.annotate.background import BackgroundJob
from getagrip.annotate.keyframes import KeyFrame
from getagrip.annotate.tasks import Task
from getagrip.annotate.versions import Change
from getagrip.cli import main
from getagrip.clip import read_clip
from getagrip.commands.annotate import DATABASE
from getagrip.errors import GetagripError
from getagrip.io.images import write_image
from helpers.annotation_page import Served, saved
from helpers.browser import IN_BROWSER, chromium, expect, until
from helpers.labelled_scene import circle, joints, middle, write_scene

pytestmark = IN_BROWSER

FIRST, BETWEEN, LAST = 2, 4, 6
MARK = "the-marked-grasp"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def video(tmp_path_factory: Any) -> Path:
    return write_scene(tmp_path_factory.mktemp("video") / "scene.mp4")


@pytest.fixture
def served(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A video in which a grasp is marked. Masks are carried at a quarter of the size, which is quicker."""
    monkeypatch.setattr(propagated_masks, "SIDE", 50.0)
    tasks = [Task("scene", "scene", video), Task("another", "another", video)]
    made = Served(tasks, tmp_path / DATABASE)
    about = {"mark": MARK, "task": "scene", "annotator": "ann", "tab": "a-tab-of-old"}
    sets = ({"start": FIRST, "side": "left", "category": "disc"}, {"end": LAST})
    for n, one in enumerate(sets):
        made.project.change(about | {"change": f"change-{n}", "set": one})
    yield made
    made.stop()


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:
    made = browser.new_context(viewport={"width": 1300, "height": 900}, accept_downloads=True)
    yield made
    made.close()


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


def test_joints_are_clicked_in_order_corrected_and_not_lost(context: Any, served: Served) -> None:
    page, points = opened(context, served), joints(FIRST)
    expect(page.locator("#joint")).to_have_text("Next: Wrist")
    click(page, points[0])
    expect(page.locator("#joint")).to_have_text("Next: Thumb root, at the wrist")
    page.keyboard.press("x")
    click(page, points[2])
    expect(page.locator("#joint")).to_have_text("Next: Thumb last joint")
    saved(page)
    state = kept(served)[FIRST].joints
    assert state["1"] == "unseen"
    assert near(state["0"], points[0])
    assert near(state["2"], points[2])
    drag(page, points[0], [100, 200])
    saved(page)
    assert near(kept(served)[FIRST].joints["0"], [100, 200])
    for _ in range(3):
        page.keyboard.press("d")  # a pixel of the screen to the right, the wrist being chosen
    page.keyboard.press("w")
    page.reload()  # what was not sent yet goes first
    shows(page, FIRST)
    saved(page)
    x, y = kept(served)[FIRST].joints["0"]
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


def test_a_polygon_is_drawn_closed_and_edited(context: Any, served: Served) -> None:
    page, points = opened(context, served), circle(FIRST, 8)
    page.keyboard.press("o")
    for point in points:
        click(page, point)
    saved(page)
    (outline,) = kept(served)[FIRST].outlines.values()
    assert not outline["closed"]
    page.reload()  # in the middle of it
    shows(page, FIRST)
    page.keyboard.press("o")
    click(page, points[0])
    saved(page)
    (outline,) = kept(served)[FIRST].outlines.values()
    assert outline["closed"]
    assert near(outline["points"], points)
    half = (np.array(points[0]) + points[1]) / 2
    click(page, half.tolist())  # on the line: a point more
    drag(page, points[3], [60, 60])
    saved(page)
    (outline,) = kept(served)[FIRST].outlines.values()
    assert near(outline["points"], [points[0], half.tolist(), *points[1:3], [60, 60], *points[4:]])
    page.keyboard.press("Delete")  # the point that was dragged
    page.keyboard.press("f")
    draw(page, circle(FIRST + 8, 5))
    saved(page)
    assert [len(shape) for shape in kept(served)[FIRST].polygons("object")] == [8]
    assert [len(shape) for shape in kept(served)[FIRST].polygons("front")] == [5]
    expect(page.locator("#outline-list li")).to_have_count(2)
    page.locator("#outline-list li.front button").click()
    saved(page)
    assert not kept(served)[FIRST].polygons("front")


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
    assert near(kept(served)[FIRST].joints["0"], [151.25, 90.5], 0.2)


def test_two_tabs_that_label_lose_nothing(context: Any, served: Served) -> None:
    one = opened(context, served)
    two = opened(context, served, None)
    click(one, [100, 100])
    expect(two.locator("#joint")).to_have_text("Next: Thumb root, at the wrist")  # without a reload
    click(two, [120, 100])
    two.keyboard.press("o")
    draw(two, circle(FIRST, 6))
    drag(one, [100, 100], [90, 80])
    saved(one)
    saved(two)
    for page in (one, two):
        expect(page.locator("#keyframes li")).to_contain_text("2 joints · 1 polygon")
    state = kept(served)[FIRST]
    assert near(state.joints["0"], [90, 80])
    assert near(state.joints["1"], [120, 100])
    assert near(state.polygons("object")[0], circle(FIRST, 6))


def test_clicks_made_while_the_server_is_away_are_kept(context: Any, served: Served) -> None:
    page = opened(context, served)
    served.stop()
    click(page, [100, 100])
    expect(page.locator("#saved")).to_contain_text("Not saved")
    page.close()
    served.start()
    again = context.new_page()
    again.goto(served.server.url)
    saved(again)
    until(again, "localStorage.length < 2")
    assert near(kept(served)[FIRST].joints["0"], [100, 100])


def test_from_clicks_to_files(context: Any, served: Served, tmp_path: Path) -> None:
    page = opened(context, served)
    for frame in (FIRST, LAST):
        goto(page, frame)
        click_joints(page, frame)
        draw_disc(page, frame)
    saved(page)
    assert near(list(kept(served)[LAST].joints.values()), joints(LAST), 0.8)
    page.keyboard.press("g")
    expect(page.locator("#fill-state")).to_have_text(f"All {LAST - FIRST + 1} frames filled in.", timeout=30_000)
    goto(page, BETWEEN)
    expect(page.locator("#layer path.draft.object")).to_have_count(1)
    expect(page.locator("#layer path.draft.hand")).to_have_count(1)
    box = page.locator("#layer path.draft.object").bounding_box()
    seen = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    assert near(seen, on_screen(page, middle(BETWEEN).tolist()), 12.0)
    page.keyboard.press("v")
    expect(page.locator("#layer path.draft")).to_have_count(0)
    page.keyboard.press("v")
    page.reload()
    shows(page, FIRST)  # what was filled in is still there
    expect(page.locator("#fill-state")).to_have_text(f"All {LAST - FIRST + 1} frames filled in.")
    goto(page, BETWEEN)
    page.keyboard.press("o")
    page.keyboard.press("t")
    saved(page)
    (taken,) = kept(served)[BETWEEN].polygons("object")
    drag(page, taken[0].tolist(), (taken[0] + [9, 9]).tolist())
    expect(page.locator("#fill-state")).to_contain_text("to be filled in")
    saved(page)
    page.click("#write")
    expect(page.locator("#command")).to_contain_text("getagrip clip new", timeout=30_000)
    (folder,) = [path for path in tmp_path.iterdir() if path.is_dir()]
    assert (folder / "hand.npz").is_file()
    assert len(list((folder / "masks").glob("*.png"))) == LAST - FIRST + 1
    with page.expect_download() as download:
        page.click("#labels-json")
    labels = json.loads(Path(download.value.path()).read_text())
    assert labels["frames"].keys() == {str(n) for n in (FIRST, BETWEEN, LAST)}


def test_it_ends_in_a_reconstruction(
    context: Any, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clip is made as the commands make it; the fit, which takes its time, is left out here."""

    def ran(words: Sequence[str], job: BackgroundJob) -> str:
        if words[0] == "clip" and main([*words]):
            raise GetagripError(f"{words[words.index('--mesh') + 1]} is refused")
        if words[0] == "report":
            folder = Path(words[1])
            folder.mkdir(parents=True)
            write_image(folder / "report.png", np.zeros((40, 200, 3), np.uint8))
            (folder / "report.html").write_text("<p>the report of a plate</p>")
        return f"{words[0]}: done"

    monkeypatch.setattr(reconstruction, "_run", ran)
    about = {"grasp": MARK, "task": "scene", "annotator": "ann", "tab": "a-tab-of-old"}
    clicked = {str(n): point for n, point in enumerate(joints(FIRST))}
    served.project.label(about | {"change": "all-joints", "frame": FIRST, "set": {"joints": clicked}})
    page = opened(context, served)
    expect(page.locator("#reconstruct")).to_be_disabled()
    draw_disc(page, FIRST)
    saved(page)
    assert page.input_value("#mesh") == "disc"  # what the grasp is of: there is no such shape
    page.click("#reconstruct")
    expect(page.locator("#fill-state")).to_contain_text("disc is refused", timeout=30_000)
    page.fill("#mesh", "plate")
    page.fill("#size-mm", "180")
    page.click("#reconstruct")
    expect(page.locator("#outcome")).to_have_text("reconstruct: done", timeout=30_000)
    until(page, "document.getElementById('report').naturalWidth == 200")
    (clip,) = (tmp_path / "clips").iterdir()
    assert np.ptp(read_clip(clip).mesh.vertices, axis=0).max() == pytest.approx(0.18)
    with context.expect_page() as opens:
        page.click("#report-page")
    expect(opens.value.locator("body")).to_contain_text("the report of a plate")


def test_the_next_step_is_shown_and_the_grasp_can_be_left(context: Any, served: Served) -> None:
    page = opened(context, served)
    expect(page.locator("#label-next")).to_contain_text("click the joints")
    before = page.locator("#screen").bounding_box()
    page.keyboard.press("g")
    expect(page.locator("#problem")).to_contain_text("nothing to fill in yet")
    assert page.locator("#screen").bounding_box() == before  # nothing moves when something is refused
    click(page, joints(FIRST)[0])
    expect(page.locator("#problem")).to_be_hidden()
    page.keyboard.press("o")
    expect(page.locator("#label-next")).to_contain_text("6 joints at least")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#label-next")).to_contain_text("not part of the grasp")
    click(page, [50, 50])
    page.keyboard.press("l")
    expect(page.locator("#definition")).to_be_visible()
    expect(page.locator("#layer *")).to_have_count(0)
    page.reload()
    expect(page.locator("#definition")).to_be_visible()
    expect(page.locator("#marks li")).to_have_count(1)
    assert kept(served).keys() == {FIRST}
    page.keyboard.press("l")
    expect(page.locator("#keyframes li")).to_have_count(1)


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
    (one,) = kept(served)[FIRST].outlines.values()
    assert (len(one["points"]), one["closed"]) == (len(border), True)
    page.mouse.click(*on_screen(page, [130, 120]))  # beside the dot, not on it
    page.mouse.click(x, y)
    saved(page)
    (one,) = kept(served)[FIRST].outlines.values()
    assert len(one["points"]) in (len(border), len(border) + 1)
    assert page.locator("#layer .corner.chosen").count() == 1


def test_what_was_just_moved_is_kept_when_another_clip_is_opened(context: Any, served: Served) -> None:
    page = opened(context, served)
    click(page, [100, 100])
    saved(page)
    before = kept(served)[FIRST].joints["0"]
    page.keyboard.press("Shift+d")
    page.keyboard.press("n")
    expect(page.locator("#where")).to_have_text("another")
    expect(page.locator("#definition")).to_be_visible()
    saved(page)
    assert kept(served)[FIRST].joints["0"][0] > before[0]
    expect(page.locator("#problem")).to_be_hidden()


def test_what_was_changed_elsewhere_is_not_undone(context: Any, served: Served) -> None:
    page = opened(context, served)
    click(page, [100, 100])
    saved(page)
    store, state = served.project.store.keyframes, kept(served)[FIRST]
    store.apply(Change("elsewhere", "another-tab", {}), state, lambda old, _: replace(old, hidden=True))
    page.keyboard.press("u")
    expect(page.locator("#problem")).to_contain_text("another tab")
    assert kept(served)[FIRST].joints
