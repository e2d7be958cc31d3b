"""Reports and the index for everybody: axe-core, the first screen, the keyboard, a phone, and thousands of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote_plus

import numpy as np
import pytest

from getagrip.cli import main
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate
from getagrip.report.pages import IndexRow, write_index, write_page
from getagrip.report.pictures.result_view import View
from getagrip.result import Candidates
from getagrip.result.findings import Finding, Probability
from helpers.accessibility import faults
from helpers.annotation import IN_BROWSER, until
from helpers.environment import needs_library
from helpers.scenes import egg_and_mug, perfect, timeline
from helpers.views import write_viewed_result

pytestmark = IN_BROWSER
SIZES = {"laptop": (1280, 720), "phone": (390, 844)}
ROWS, SETS = 2000, 3
SEEN_OF_SCENE = """(() => {
  const box = document.querySelector(".scene").getBoundingClientRect();
  return Math.min(box.bottom, controls.getBoundingClientRect().top) - Math.max(0, box.top);
})()"""
"""Height of the 3D view that nothing covers [px]."""


@pytest.fixture(scope="module")
def report(tmp_path_factory: Any) -> Path:
    """A page of a result with a serious finding, a note, numbers, candidates and a probability."""
    clip, masks = egg_and_mug()
    good = perfect(clip)
    T = good.T_hand_obj @ se3.rigid(t=np.array([0.0, 0.03, 0.0]))
    found = (
        Finding("poor-mask-fit", True, 0.6, 0.85, "the overlap is 0.60, where 0.85 is usual: the mesh may be wrong"),
        Finding("penetration", False, 40.0, 35.0, "the hand is 40 mm deep inside"),
    )
    pair = Candidates(np.stack([T, good.T_hand_obj]), np.ones(2), np.array([1.0, 2.0]))
    result = replace(
        good, T_hand_obj=T, findings=found, candidates=pair, ambiguous=True, probability_right=Probability(0.5, "")
    )
    folder: Path = tmp_path_factory.mktemp("report")
    return write_page(View.of(result, clip, masks), evaluate(result, clip, masks), {}, folder / "report.html")


def made_up_row(n: int) -> IndexRow:
    if n % 100 == 99:
        return IndexRow(f"{n:04d}", "no hand", flags=("failed",))
    iou, flags = 0.5 + 0.005 * (n % 100), ("serious",) if n % 10 == 0 else ()
    values = {"IOU": iou, "probability right in the hand": (n % 100) / 100.0, "time": float(n)}
    warnings = ("poor-mask-fit: low",) * len(flags)
    return IndexRow(
        f"{n % SETS}/{n:04d}", clip=f"clip-{n:04d}", method="static", flags=flags, warnings=warnings, values=values
    )


@pytest.fixture(scope="module")
def index(tmp_path_factory: Any) -> Path:
    return write_index([made_up_row(n) for n in range(ROWS)], "many", (), tmp_path_factory.mktemp("i") / "index.html")


def opened(browser: Any, path: Path, size: tuple[int, int] = SIZES["laptop"], chosen: str = "", **how: Any) -> Any:
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, bypass_csp=True, **how)
    page = context.new_page()
    page.on("pageerror", lambda error: pytest.fail(f"the page raised {error}"))
    page.goto(path.as_uri() + chosen)
    page.locator("body[data-ready]").wait_for()
    return page


@needs_library("axe_playwright_python")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_contrast_labels_and_roles(browser: Any, report: Path, index: Path, scheme: str, size: str) -> None:
    for path in (report, index):
        page = opened(browser, path, SIZES[size], color_scheme=scheme)
        page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        page.evaluate("document.querySelectorAll('.bar')[2]?.click()")
        assert faults(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == SIZES[size][0]
        page.context.close()


@needs_library("axe_playwright_python")
@pytest.mark.slow
def test_the_words_of_segments_can_be_read(browser: Any, tmp_path: Path) -> None:
    clip, masks = timeline()
    result = perfect(clip)
    path = write_page(View.of(result, clip, masks), evaluate(result, clip, masks), {}, tmp_path / "report.html")
    page = opened(browser, path)
    assert faults(page) == []
    page.get_by_label("grid").check()
    assert page.inner_text(".measures") == "squares of 5 cm on the ground"
    page.context.close()


def test_most_of_the_first_screen_is_the_picture(browser: Any, report: Path) -> None:
    page = opened(browser, report)
    assert page.locator(".warnings .serious li").is_visible()
    assert page.evaluate(SEEN_OF_SCENE) >= 0.6 * 720
    page.context.close()


@pytest.mark.slow
def test_so_it_is_beside_the_images_of_further_views(browser: Any, tmp_path: Path) -> None:
    folder = write_viewed_result(tmp_path)
    assert main(["report", str(folder)]) == 0
    page = opened(browser, folder / "report.html")
    assert page.evaluate(SEEN_OF_SCENE) >= 0.6 * 720
    page.context.close()


def test_a_grid_states_its_scale_and_is_there_again(browser: Any, report: Path) -> None:
    """Of the object's lowest point, as no ground is known; by its box or its key, whatever has the focus."""
    page = opened(browser, report)
    bare = page.locator(".scene").screenshot()
    page.keyboard.press("g")
    assert page.get_by_label("grid").is_checked()
    assert page.inner_text(".measures") == "squares of 5 cm at the object's lowest point, level with the camera"
    page.wait_for_timeout(100)
    gridded = page.locator(".scene").screenshot()
    assert gridded != bare
    page.focus("#play")
    page.keyboard.press("a")
    assert page.get_by_label("axes").is_checked()
    assert "x red, y green, z blue" in page.inner_text(".measures")
    page.wait_for_timeout(100)
    assert page.locator(".scene").screenshot() != gridded
    page.reload()
    page.locator("body[data-ready]").wait_for()
    assert page.get_by_label("grid").is_checked()
    page.keyboard.press("g")
    page.keyboard.press("a")
    assert page.locator(".measures").is_hidden()
    page.context.close()


def shown(page: Any) -> int:
    return int(page.get_attribute(".rows", "aria-rowcount")) - 1


def test_a_bar_filters_and_a_second_press_clears(browser: Any, index: Path) -> None:
    page = opened(browser, index)
    bar = page.get_by_role("button", name="IOU 50 to 55 %: 200 rows")
    assert shown(page) == ROWS
    bar.click()
    assert shown(page) == 200
    assert "200 shown" in page.inner_text("#facts")
    assert page.get_by_role("button", name="serious finding: 20 rows").is_visible()  # the other bars count what is left
    assert page.get_by_role("button", name="IOU 60 to 65 %: 200 rows").is_visible()  # its own what one could choose
    assert bar.get_attribute("aria-pressed") == "true"
    page.get_by_role("button", name="serious finding: 20 rows").focus()
    page.keyboard.press("Enter")
    assert shown(page) == 20
    assert page.input_value("#flags") == "serious"
    again = opened(browser, index, chosen=page.evaluate("location.hash"))  # the address keeps it
    assert shown(again) == 20
    again.context.close()
    page.keyboard.press("Enter")  # the focus is where it was
    assert shown(page) == 200
    page.get_by_role("button", name="IOU 50 to 55 %").click()
    assert shown(page) == ROWS
    assert page.evaluate("location.hash") == ""
    page.context.close()


def test_an_address_chooses_only_what_there_is(browser: Any, index: Path) -> None:
    page = opened(browser, index, chosen="#flags=nonsense&IOU=3&order=best&words=clip-0007")
    assert shown(page) == 1
    assert page.input_value("#flags") == "any"
    assert unquote_plus(page.evaluate("location.hash")) == "#words=clip-0007&order=best"
    page.context.close()


@pytest.mark.parametrize("form", ["table", "gallery"])
def test_of_thousands_of_rows_those_near_the_window_are_drawn(browser: Any, index: Path, form: str) -> None:
    page = opened(browser, index, chosen=f"#form={form}&by=time&order=worst")
    rows = ".name a, .name > span" if form == "table" else "figcaption > span"
    page.wait_for_timeout(200)
    assert 24 <= page.locator(f"main {rows}").count() < 200
    last = page.locator(f"main {rows}", has_text="clip-0000")
    for _ in range(20):  # heights are known better and better
        page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        page.wait_for_timeout(100)
        if last.count() and page.evaluate("scrollY + innerHeight >= document.documentElement.scrollHeight - 2"):
            break
    assert last.count() == 1
    assert page.locator(f"main {rows}").count() < 200
    page.evaluate("scrollTo(0, 0)")
    until(page, "document.querySelector('main').innerText.includes('0099')")
    page.context.close()
