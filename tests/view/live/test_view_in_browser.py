"""The page in a real browser: nothing is complained of or fetched from elsewhere, and what is shown moves."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from PIL import Image

from getagrip.view.live.entries import Entry
from getagrip.view.live.page import Page
from getagrip.view.live.server import serve
from helpers.browser import IN_BROWSER, READS_BACK
from helpers.needs import needs
from helpers.two_candidates import column

pytestmark = [*IN_BROWSER, needs("viser", "view"), pytest.mark.slow]

PATIENCE = 60_000
"""On a busy machine a page takes its time [ms]."""
KNOWN = "THREE.Clock: This module has been deprecated"
"""What viser's own page warns of."""


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    served = serve()
    page = Page(served.viser, [Entry("one")], [column()])
    served.viser.scene.configure_environment_map(None)  # takes seconds without a graphics card
    thread = threading.Thread(target=page.run)
    thread.start()
    yield served.url
    page.stop()
    thread.join()
    served.stop()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    tab = browser.new_page(viewport={"width": 1000, "height": 480})
    yield tab
    tab.close()


def middle(page: Any) -> np.ndarray:
    """The middle of the page, where the scene is."""
    clip = {"x": 470, "y": 90, "width": 200, "height": 300}
    picture = page.screenshot(clip=clip, timeout=PATIENCE)
    return np.array(Image.open(BytesIO(picture)).convert("RGB")).astype(int)


def coloured(picture: np.ndarray) -> np.ndarray:
    """Pixels that are neither white nor grey: of hand and object."""
    return np.asarray(np.ptp(picture, axis=-1) > 25)


def test_the_scene_moves_with_the_slider_and_with_a_press_on_a_curve(page: Any, url: str) -> None:
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{url}?fixedDpr=0.5")
    frame = page.locator("input[inputmode=decimal]").first
    frame.wait_for(timeout=PATIENCE)
    for _ in range(100):  # the scene fades in
        first = middle(page)
        if coloured(first).mean() > 0.1:
            break
        page.wait_for_timeout(200)
    assert coloured(first).mean() > 0.1

    frame.fill("5")
    page.get_by_text("000004, at").wait_for(timeout=PATIENCE)
    page.wait_for_timeout(500)
    last = middle(page)
    assert (np.abs(last - first).max(axis=-1) > 40).mean() > 0.01

    plot = page.locator("svg[onpointerdown]").first
    box = plot.bounding_box()
    middle_frame = {"clientX": box["x"] + box["width"] * 0.53, "clientY": box["y"] + 40}
    plot.dispatch_event("pointerdown", middle_frame)
    page.get_by_text("000002, at").wait_for(timeout=PATIENCE)
    assert frame.input_value() == "3"

    amiss = [text for text in said if text.startswith(("error", "warning"))]
    assert [text for text in amiss if KNOWN not in text and READS_BACK not in text] == []
    assert all(address.startswith((url, "data:", "blob:")) for address in asked)
