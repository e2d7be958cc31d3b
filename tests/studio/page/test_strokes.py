"""Strokes in a real browser: drawn by dragging or a click, filled in at once, corrected and taken back."""

from __future__ import annotations

from typing import Any

import pytest

from helpers.annotation import FIRST_FRAME, IN_BROWSER, LAST_FRAME, Served, click, drag, expect, kept, opened, saved
from helpers.labelled_scene import middle

pytestmark = IN_BROWSER


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
