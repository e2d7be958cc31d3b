"""The page of a timeline shows what is when: as a bar under the slider, and in its curves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from getagrip.metrics.evaluate import evaluate
from getagrip.report.pages import write_page
from getagrip.report.pictures.result_view import View
from getagrip.result import SegmentResult
from helpers.annotation import IN_BROWSER
from helpers.scenes import COMES, LIES, perfect, timeline

pytestmark = [*IN_BROWSER, pytest.mark.slow]


def test_segments_are_a_bar_that_jumps_and_divide_the_curves(browser: Any, tmp_path: Path) -> None:
    clip, masks = timeline()
    records = tuple(
        SegmentResult(state=s.state, first=clip.frames[s.first], last=clip.frames[s.last]) for s in clip.segments
    )
    result = replace(perfect(clip), segments=records)
    path = write_page(View.of(result, clip, masks), evaluate(result, clip, masks), {}, tmp_path / "report.html")
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(path.as_uri())
    page.locator("body[data-ready]").wait_for()
    bar = page.locator("#segments button")
    assert bar.all_inner_texts() == ["static", "contact, right hand", "grasp, right hand"]
    boxes = [bar.nth(k).bounding_box() for k in range(3)]
    frame = (boxes[2]["x"] + boxes[2]["width"] - boxes[0]["x"]) / (len(clip) - 1)
    for box, frames in zip(boxes, (LIES - 0.5, COMES, len(clip) - LIES - COMES - 0.5), strict=True):
        assert box["width"] == pytest.approx(frames * frame, abs=1.0)
    bar.nth(2).click()
    assert f"{LIES + COMES + 1} of {len(clip)}" in page.inner_text("#frame")
    plot = page.locator(".plot svg").first
    assert (plot.locator(".border").count(), plot.locator("rect").count()) == (2, 3)
    assert "SCA 10 mm, in grasps" in page.locator(".main dt").all_inner_texts()
    page.close()
