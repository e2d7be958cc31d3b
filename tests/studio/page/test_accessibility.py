"""The page for everybody: contrast, labels and roles by axe-core, light and dark; by keyboard alone, by touch alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from getagrip.result import write_result
from getagrip.result.findings import Finding, Probability
from getagrip.studio import jobs
from helpers.accessibility import faults
from helpers.annotation import (
    FIRST_FRAME,
    IN_BROWSER,
    LAST_FRAME,
    MARK,
    Served,
    close,
    draw_disc,
    expect,
    kept,
    near,
    on_screen,
    opened,
    saved,
    shows,
)
from helpers.clips import small_clip
from helpers.environment import needs_library
from helpers.results import true_result

pytestmark = IN_BROWSER


@needs_library("axe_playwright_python")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast_labels_and_roles(
    browser: Any, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scheme: str
) -> None:
    """While marking, while labelling, and with a result; on a phone, too."""
    found = tuple(Finding("hand-size", worse, 1.0, 0.5, f"it is {worse}") for worse in (True, False))

    def ran(words: list[str], job: object) -> str:
        if words[0] == "reconstruct":
            one, folder = (
                true_result(small_clip()[0], None),
                Path(words[words.index("--out") + 1]) / Path(words[1]).name,
            )
            about: dict[str, Any] = {"findings": found, "assumptions": {"scale": "by the hand"}}
            about["probability_right"] = Probability(0.5, "")
            write_result(replace(one, **about), folder, "", {}, tmp_path, overwrite=folder.is_dir())
        return "done"

    monkeypatch.setattr(jobs, "run_command", ran)
    context = browser.new_context(viewport={"width": 1280, "height": 720}, color_scheme=scheme)
    page = context.new_page()
    page.goto(f"{served.server.url}#scene")
    assert faults(page) == []  # who is marking?
    page.fill("#name-field", "ann")
    page.keyboard.press("Enter")
    shows(page, 0)
    assert faults(page) == []
    page.keyboard.press("?")
    assert faults(page) == []
    page.keyboard.press("?")
    page.keyboard.press("l")
    shows(page, FIRST_FRAME)
    for tool in "jo":
        page.keyboard.press(tool)
        assert faults(page) == []
    draw_disc(page, FIRST_FRAME)
    served.project.label(
        {
            "grasp": MARK,
            "task": "scene",
            "annotator": "ann",
            "tab": "another-tab",
            "change": "all-joints",
            "frame": FIRST_FRAME,
        }
        | {"set": {"joints": {str(n): [100.0 + n, 100.0 + n * n % 7] for n in range(21)}}}
    )
    page.fill("#mesh", "plate")
    expect(page.locator("#reconstruct")).to_be_enabled()
    page.click("#reconstruct")
    expect(page.locator("#verdict")).to_be_visible(timeout=30_000)
    page.click("#findings summary")
    assert faults(page) == []
    page.set_viewport_size({"width": 390, "height": 844})
    assert faults(page) == []
    close(context)


def test_a_grasp_is_marked_by_touch_alone(browser: Any, served: Served) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    page = context.new_page()
    page.goto(served.server.url)
    page.fill("#name-field", "bob")
    page.tap("dialog button")
    shows(page, 0)
    page.tap("#side button[data-side=left]")
    page.tap("#ends button:has-text('Starts here')")
    for n in range(3):
        page.tap("#transport button:has-text('1 ▶')")
        shows(page, n + 1)
    page.tap("#ends button:has-text('Ends here')")
    saved(page)
    (mark,) = served.project.marks("scene", "bob")["marks"]  # type: ignore[misc]
    assert (mark["start"], mark["end"], mark["side"]) == (0, 3, "left")
    page.tap("#ends button:has-text('Label')")
    expect(page.locator("#label-title")).to_have_text("Frames 1 – 4")
    close(context)


CROSS = """(() => {
  const [, y, , x] = document.querySelector("#layer .cross").getAttribute("d").match(/[\\d.]+/g).map(Number);
  return [x, y];
})()"""
"""Where the keyboard draws."""


@pytest.mark.parametrize("by", ["keyboard", "touch"])
def test_strokes_and_polygons_are_drawn_without_a_mouse(browser: Any, served: Served, by: str) -> None:
    context = browser.new_context(viewport={"width": 820, "height": 1180}, has_touch=by == "touch")
    page = context.new_page()
    page.goto(f"{served.server.url}#annotator=ann")
    shows(page, FIRST_FRAME)

    def tool(name: str, key: str) -> None:
        if by == "touch":
            page.tap(f"#tools button[data-tool={name}]")
        else:
            page.keyboard.press(key)

    def point(at: tuple[float, float]) -> None:
        """Where nothing is further away than a hundred presses of a key."""
        if by == "touch":
            page.touchscreen.tap(*on_screen(page, at))
            return
        if not page.locator("#layer .cross").count():
            page.keyboard.press(".")
        for axis, (less, more) in enumerate((("a", "d"), ("w", "x"))):
            for faster in ("Shift+", ""):
                for _ in range(100):
                    left = at[axis] - page.evaluate(CROSS)[axis]
                    if abs(left) <= (25.0 if faster else 3.0):
                        break
                    page.keyboard.press(faster + (more if left > 0 else less))
        page.keyboard.press(".")

    tool("on", "q")
    for at in ((130.0, 110.0), (150.0, 120.0)):
        point(at)
    saved(page)
    strokes = [one["points"] for one in kept(served)[FIRST_FRAME].outlines.values() if one["of"] == "on"]
    assert near(strokes, [[[130.0, 110.0]], [[150.0, 120.0]]], 3.0)
    tool("object", "o")
    for at in ((100.0, 90.0), (160.0, 90.0), (130.0, 150.0)):
        point(at)
    if by == "touch":
        page.tap("#outlines button:has-text('Close')")
    else:
        page.keyboard.press("Enter")
    saved(page)
    (polygon,) = kept(served)[FIRST_FRAME].polygons("object")
    assert near(polygon, [[100.0, 90.0], [160.0, 90.0], [130.0, 150.0]], 3.0)
    close(context)


def test_buttons_are_pressed_by_the_keyboard(context: Any, served: Served) -> None:
    """Space and Enter press the button that has the focus; the mouse leaves no focus."""
    page = opened(context, served)
    page.focus("#back")
    page.keyboard.press("Enter")
    expect(page.locator("#definition")).to_be_visible()
    page.focus("#marks button.text")
    page.keyboard.press(" ")
    expect(page.locator("#marks li")).to_have_class("grasp chosen")
    page.focus("#timeline")
    before = int(page.get_attribute("#timeline", "aria-valuenow"))
    page.keyboard.press("ArrowRight")
    expect(page.locator("#timeline")).to_have_attribute("aria-valuenow", str(before + 1))
    page.click("#closer")
    assert page.evaluate("document.activeElement === document.body")


PLACES = """addEventListener("DOMContentLoaded", () => {
  window.places = [];
  const note = () => picture.width > 16 && places.push(layer.getAttribute("transform"));
  new MutationObserver(note).observe(layer, { attributes: true });
})"""


@pytest.mark.parametrize("size", [(1020, 680), (1280, 720), (390, 844)])
def test_the_picture_stands_still_from_its_first_frame_on(browser: Any, served: Served, size: tuple[int, int]) -> None:
    """Also where the window is narrow, as at 150 %: no line beside it wraps later, however long its words become."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    page = context.new_page()
    page.add_init_script(PLACES)
    page.goto(f"{served.server.url}#annotator=ann")
    shows(page, FIRST_FRAME)
    page.keyboard.press("End")
    shows(page, LAST_FRAME)
    page.wait_for_timeout(300)
    assert len(set(page.evaluate("places"))) == 1
    page.evaluate("frame.textContent = 9999; time.textContent = '1:23.45'")
    page.wait_for_timeout(100)
    assert len(set(page.evaluate("places"))) == 1
    assert page.evaluate("document.documentElement.scrollWidth") == size[0]
    close(context)
