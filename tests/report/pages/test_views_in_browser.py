"""The page of a clip with views in a real browser: images of each camera, cameras in 3D, and the eye at each."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from getagrip.cli import main
from helpers.annotation import IN_BROWSER, READS_BACK, expect
from helpers.views import NAMES, write_viewed_result

pytestmark = [*IN_BROWSER, pytest.mark.slow]


def scene(page: Any) -> np.ndarray:
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return np.array(Image.open(BytesIO(page.locator(".scene").screenshot())).convert("RGB")).astype(int)


def shown(picture: np.ndarray) -> np.ndarray:
    """The pixels that are not the paper's."""
    return np.abs(picture - picture[2, 2]).max(axis=-1) > 30


@pytest.mark.parametrize("width", [1280, 390])
def test_each_view_has_its_images_and_its_camera(browser: Any, tmp_path: Path, width: int) -> None:
    folder = write_viewed_result(tmp_path)
    assert main(["report", str(folder)]) == 0
    page = browser.new_page(viewport={"width": width, "height": 2600})
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto((folder / "report.html").as_uri())
    page.locator("body[data-complete]").wait_for()
    names = page.locator(".views button")
    assert names.all_inner_texts() == [*NAMES]
    assert all("IOU" in words for words in page.locator(".views .met").all_inner_texts())
    page.locator("#slider").fill("2")
    expect(page.locator(".views .outlines .object .line").first).to_have_attribute("d", page.evaluate(
        "data.shown.columns[0].pictures[2].views[0].outlines.object"
    ))  # fmt: skip
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")

    own = scene(page)
    names.nth(1).click()
    assert page.get_by_label("seen from").input_value() == "view 1"
    other = scene(page)
    assert (np.abs(own - other).max(axis=-1) > 40).mean() > 0.01
    page.get_by_label("seen from").select_option("camera")
    np.testing.assert_allclose(scene(page), own, atol=8)

    page.get_by_label("cameras", exact=True).check()
    far = scene(page)
    columns = np.flatnonzero(shown(far).any(axis=0))
    assert np.ptp(columns) > 0.4 * far.shape[1]  # cameras stand on all sides
    for colour in ("#7d858c", "#2a7f9e", "#d19a2a"):
        rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert (np.abs(far - rgb).max(axis=-1) < 24).sum() > 10, colour
    page.get_by_label("cameras", exact=True).uncheck()
    np.testing.assert_allclose(scene(page), own, atol=8)
    assert [words for words in said if READS_BACK not in words] == []
