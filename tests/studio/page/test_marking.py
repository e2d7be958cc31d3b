"""The annotation page in a real browser: open, step, mark, reload, nothing lost; two tabs at once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.studio.store.tasks import Task
from helpers.annotation import IN_BROWSER, Served, expect, saved
from helpers.labelled_scene import BITS, NUMBERED_FRAMES, write_video

pytestmark = IN_BROWSER

RIGHT = "#side [data-side=right]"

READ_CANVAS = f"""() => {{
  const canvas = document.getElementById("picture"), context = canvas.getContext("2d");
  let number = 0;
  for (let bit = 0; bit < {BITS}; bit += 1) {{
    const [red] = context.getImageData((bit + 0.5) * canvas.width / {BITS}, canvas.height / 2, 1, 1).data;
    if (red > 127) number |= 1 << bit;
  }}
  return number;
}}"""


@pytest.fixture(scope="module")
def videos(tmp_path_factory: Any) -> list[Path]:
    folder = tmp_path_factory.mktemp("videos")
    return [write_video(folder / f"{name}.mp4") for name in ("first", "second")]


@pytest.fixture
def served(videos: list[Path], tmp_path: Path) -> Iterator[Served]:
    first, second = videos
    tasks = [Task("first", "first", first), Task("second", "second", second, 11, 50, "left", "mug", "red mug", 20)]
    made = Served(tasks, tmp_path / DATABASE)
    yield made
    made.stop()


def opened(context: Any, served: Served, who: str | None = "ann") -> Any:
    """A tab with the page, its first frame on the screen; `who` is None where the browser knows the name."""
    page = context.new_page()
    page.on("pageerror", lambda error: pytest.fail(f"the page raised {error}"))
    page.goto(served.server.url)
    if who is not None:
        page.fill("#name-field", who)
        page.keyboard.press("Enter")
    shows(page, 1)
    return page


def shows(page: Any, number: int) -> None:
    """Wait until a frame is on the screen, and see that it is that frame."""
    expect(page.locator("#frame")).to_have_text(str(number))
    assert page.evaluate(READ_CANVAS) == number - 1


def mark(page: Any, start: int, end: int) -> None:
    """Mark a grasp of the right hand with the keyboard, from the first frame on."""
    page.click(RIGHT)
    page.keyboard.press("Home")
    shows(page, 1)
    for _ in range(start):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("s")
    for _ in range((end - start) // 10):
        page.keyboard.press("Shift+ArrowRight")
    for _ in range((end - start) % 10):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("e")
    expect(page.locator("#marks li").first).to_contain_text(f"– {end + 1}")
    saved(page)


def test_step_mark_reload_nothing_is_lost(context: Any, served: Served) -> None:
    asked: list[str] = []
    context.on("request", lambda request: asked.append(request.url))
    page = opened(context, served)
    page.keyboard.press("ArrowRight")
    shows(page, 2)
    page.keyboard.press("Shift+ArrowRight")
    shows(page, 12)
    page.keyboard.press("ArrowLeft")
    shows(page, 11)
    page.keyboard.press("End")
    shows(page, NUMBERED_FRAMES)
    page.keyboard.press("ArrowRight")
    shows(page, NUMBERED_FRAMES)
    mark(page, 3, 25)
    page.fill("#category", "plate")
    page.keyboard.press("Enter")
    page.keyboard.press("h")
    saved(page)
    assert served.grasps() == [(3, 25, "left", "plate")]
    page.reload()
    shows(page, 1)
    expect(page.locator("#marks li")).to_contain_text("4 – 26")
    expect(page.locator("#category")).to_have_value("plate")
    for _ in range(4):  # hand, object, end, start
        page.keyboard.press("u")
    expect(page.locator("#marks li")).to_have_count(0)
    saved(page)
    assert served.grasps() == []
    here = f"http://127.0.0.1:{served.port}/"
    assert all(url.startswith(here) for url in asked)  # nothing is asked of other hosts
    assert page.url == f"{here}#first"  # without the token


def test_nothing_is_said_of_the_zoom_before_there_is_a_picture(context: Any, served: Served) -> None:
    page = context.new_page()
    page.goto(served.server.url)
    expect(page.locator("#name")).to_be_visible()
    expect(page.locator("#zoom")).to_have_text("–")
    page.fill("#name-field", "ann")
    page.keyboard.press("Enter")
    shows(page, 1)
    assert 0 < int(page.inner_text("#zoom").removesuffix(" %")) < 2000


def test_two_tabs_at_once(context: Any, served: Served) -> None:
    one = opened(context, served)
    two = opened(context, served, None)
    mark(one, 3, 25)
    expect(two.locator("#marks li")).to_have_count(1)  # without a reload
    two.keyboard.press("End")
    shows(two, NUMBERED_FRAMES)
    two.locator("#marks li").click()
    shows(two, 4)
    two.keyboard.press("ArrowRight")
    two.keyboard.press("s")  # the second tab moves the start, the first one the kind of object
    one.fill("#category", "bowl")
    one.keyboard.press("Enter")
    saved(one)
    saved(two)
    for page in (one, two):
        expect(page.locator("#marks li")).to_contain_text("5 – 26")
        expect(page.locator("#marks li")).to_contain_text("bowl")
    assert served.grasps() == [(4, 25, "right", "bowl")]


def test_marks_made_while_the_server_is_away_are_kept(context: Any, served: Served) -> None:
    page = opened(context, served)
    served.stop()
    page.keyboard.press("s")
    expect(page.locator("#saved")).to_contain_text("Not saved")
    served.start()
    saved(page)
    assert [grasp[0] for grasp in served.grasps()] == [0]


def test_marks_made_while_the_server_is_away_outlive_the_tab(context: Any, served: Served) -> None:
    page = opened(context, served)
    served.stop()
    page.keyboard.press("s")
    expect(page.locator("#saved")).to_contain_text("Not saved")
    page.close()
    served.start()
    again = opened(context, served, None)
    saved(again)
    expect(again.locator("#marks li")).to_have_count(1)
    assert [grasp[0] for grasp in served.grasps()] == [0]


def test_marks_do_not_go_to_another_database(context: Any, served: Served, tmp_path: Path) -> None:
    page = opened(context, served)
    served.stop()
    own, served.database = served.database, tmp_path / "other.sqlite"
    served.start()
    page.keyboard.press("s")
    expect(page.locator("#saved")).to_contain_text("the address that getagrip annotate has")
    assert served.grasps() == []
    served.stop()
    served.database = own
    served.start()
    saved(page)
    assert [grasp[0] for grasp in served.grasps()] == [0]


def go(page: Any, number: int) -> None:
    """Go to a frame from the first one on."""
    page.keyboard.press("Home")
    for key, times in (("Shift+ArrowRight", (number - 1) // 10), ("ArrowRight", (number - 1) % 10)):
        for _ in range(times):
            page.keyboard.press(key)
    shows(page, number)


def segments(served: Served) -> list[tuple[Any, ...]]:
    return [(one.state, one.start, one.end) for one in served.project.store.marks.standing() if one.start is not None]


def test_a_whole_interaction_is_marked_state_by_state(context: Any, served: Served) -> None:
    page = opened(context, served)
    page.click(RIGHT)
    for number, key in ((1, "t"), (21, "c"), (26, "g"), (61, "e")):
        go(page, number)
        page.keyboard.press(key)
    saved(page)
    assert segments(served) == [("static", 0, 19), ("contact", 20, 24), ("grasp", 25, 60)]
    expect(page.locator("#bars div")).to_have_text(["1 lies still", "2 unstable contact", "3 stable grasp"])
    expect(page.locator("#amiss li")).to_contain_text(["the camera must be known"])
    page.check("#still")
    expect(page.locator("#amiss li")).to_have_count(0)
    page.locator("#marks li").first.click()  # its end moves, and with it the start of what adjoins it
    go(page, 18)
    page.keyboard.press("e")
    page.keyboard.press("Escape")
    go(page, 23)  # the rest of the contact is part of the grasp
    page.keyboard.press("g")
    saved(page)
    assert segments(served) == [("static", 0, 17), ("contact", 18, 21), ("grasp", 22, 60)]
    page.locator("#marks li").nth(1).click()
    page.keyboard.press("Delete")
    expect(page.locator("#amiss li")).to_contain_text(["Frames 19 to 22 are in no segment, between 1 and 2"])
    page.keyboard.press("l")  # all of it
    expect(page.locator("#label-title")).to_have_text("Frames 1 – 61")


def test_the_hand_is_asked_for(context: Any, served: Served) -> None:
    page = opened(context, served)
    expect(page.locator("#side [aria-checked=true]")).to_have_count(0)
    page.keyboard.press("s")
    expect(page.locator("#side")).to_have_class("choice wanted")
    page.keyboard.press("e")
    expect(page.locator("#next-step")).to_contain_text("which hand holds the object")
    saved(page)
    assert served.grasps() == [(0, None, None, None)]
    page.keyboard.press("h")
    expect(page.locator("#side")).to_have_class("choice")
    page.keyboard.press("h")
    page.keyboard.press("e")
    saved(page)
    assert served.grasps() == [(0, 0, "left", None)]


def test_candidates_are_gone_through_and_discarded(context: Any, served: Served) -> None:
    page = opened(context, served)
    page.keyboard.press("n")
    shows(page, 11)  # where the candidate may begin
    expect(page.locator("#category")).to_have_value("mug")
    expect(page.locator("#side [aria-checked=true]")).to_have_text("Left")
    page.keyboard.press("3")
    saved(page)
    expect(page.locator("#progress")).to_have_text("1 of 2 done")
    page.keyboard.press("s")
    expect(page.locator("#next-step")).to_contain_text("discarded")
    page.keyboard.press("3")
    page.keyboard.press("s")
    saved(page)
    assert served.grasps() == [(10, None, "left", "mug")]
    page.reload()  # comes back to the clip that was open
    shows(page, 11)
    expect(page.locator("#marks li")).to_have_count(1)


def test_playback_shows_frames_in_order_and_stops_at_the_end(context: Any, served: Served) -> None:
    page = opened(context, served)
    page.keyboard.press("End")
    for _ in range(2):
        page.keyboard.press("Shift+ArrowLeft")
    shows(page, NUMBERED_FRAMES - 20)
    page.evaluate(
        """() => { window.seen = []; new MutationObserver(() =>
        seen.push(Number(document.getElementById("frame").textContent)))
        .observe(document.getElementById("frame"), {childList: true, characterData: true, subtree: true}); }"""
    )
    page.keyboard.press(" ")
    expect(page.locator("#frame")).to_have_text(str(NUMBERED_FRAMES))
    shows(page, NUMBERED_FRAMES)
    seen = page.evaluate("seen")  # as many as the machine keeps up with
    assert seen == sorted(seen)
    assert seen[-1] == NUMBERED_FRAMES
    expect(page.locator("#play")).to_contain_text("Play")
