"""The served page in a real browser: results side by side that move with one slider, and words that stay words."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from getagrip.clip import input_sha256, write_clip
from getagrip.report.pages.viewer import ViewerLibrary, ViewerServer, group_entries
from getagrip.result import write_result
from helpers.annotation import IN_BROWSER, READS_BACK, expect, until
from helpers.results import two_candidates

pytestmark = [*IN_BROWSER, pytest.mark.slow]
GREEN = 0, 255, 0
EVIL = "<img src=x onerror=hacked=1><script>hacked=1<"


@pytest.fixture(scope="module")
def served(tmp_path_factory: Any) -> Iterator[ViewerServer]:
    """Two results of a clip, and a second clip whose folder is gone by the time it is opened."""
    root: Path = tmp_path_factory.mktemp("view")
    result, clip, masks = two_candidates()
    clip = replace(clip, mesh=replace(clip.mesh, colours=np.full_like(clip.mesh.vertices, GREEN, dtype=np.uint8)))
    where = write_clip(replace(clip, category=EVIL), masks, root / "clip")
    gone = write_clip(clip, masks, root / "gone")
    for method in ("one-dof", "static"):
        write_result(replace(result, method=method), root / method, input_sha256(where), clip_folder=where)

    def fail(error: Exception) -> None:
        raise error

    with ViewerServer(
        ViewerLibrary(group_entries([root / "one-dof", root / "static"], [gone], None, fail), fail), 0
    ) as made:
        (gone / "clip.json").unlink()
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def scene(page: Any, column: int) -> np.ndarray:
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture = page.locator(".scene").nth(column).screenshot()
    return np.array(Image.open(BytesIO(picture)).convert("RGB")).astype(int)


def differs(one: np.ndarray, other: np.ndarray) -> bool:
    return bool((np.abs(one - other).max(axis=-1) > 40).mean() > 0.005)


def test_results_move_together_and_words_stay_words(browser: Any, served: ViewerServer) -> None:
    page = browser.new_page(viewport={"width": 1000, "height": 1100})
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(served.url)
    page.locator("body[data-ready='3d']").wait_for()
    assert page.locator("article h2").all_inner_texts() == ["1-DoF, ours", "Static"]
    assert EVIL in page.locator(".facts").first.inner_text()
    expect(page.locator(".plot")).to_have_count(3)  # the gap comes last

    first, start = [scene(page, k) for k in (0, 1)], page.locator(".outlines .object .line").nth(1).get_attribute("d")
    for picture in first:  # the mesh's own colours
        assert (picture[..., 1] - picture[..., [0, 2]].max(axis=-1) > 100).mean() > 0.005
    page.locator("#slider").fill("4")
    assert "frame 000004" in page.inner_text("#frame")
    line = page.locator(".outlines .object .line").nth(1)
    until(page, f"document.querySelectorAll('.outlines .object .line')[1].getAttribute('d') !== {start!r}")
    before = line.get_attribute("d")
    assert all(differs(first[k], scene(page, k)) for k in (0, 1))

    page.get_by_label("pose").nth(1).select_option("1")
    until(page, f"document.querySelectorAll('.outlines .object .line')[1].getAttribute('d') !== {before!r}")
    assert page.locator(".other").nth(1).is_visible()
    page.get_by_text("Compare the candidates").nth(1).click()
    expect(page.locator(".chosen")).to_contain_text("150")
    expect(page.locator(".below").nth(1)).to_contain_text("energy 50 % above the lowest")

    turned = scene(page, 0)
    page.get_by_label("seen from").select_option("hand")
    assert differs(turned, scene(page, 0))
    turned = scene(page, 0)
    box = page.locator(".scene").nth(1).bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 190, box["y"] + 120)
    page.mouse.up()
    assert differs(turned, scene(page, 0))  # one eye for all

    page.get_by_role("button", name="next ›").click()
    expect(page.locator("#trouble")).to_contain_text("clip.json")
    page.get_by_role("button", name="‹ previous").click()
    expect(page.locator("#trouble")).to_be_hidden()
    refused = "the server responded with a status of 422"
    assert [text for text in said if READS_BACK not in text and refused not in text] == []
    assert page.evaluate("typeof hacked") == "undefined"
    assert all(address.startswith((served.url, "data:image/jpeg;base64,")) for address in asked)
    page.close()
