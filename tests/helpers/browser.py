"""A browser without a window, where there is one on the machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from helpers.needs import needs

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE = 30_000
"""What is expected of a page may take so long [ms]."""
IN_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
    needs("playwright"),
]
"""Marks of tests that use it."""
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing")
"""Arguments with which it renders WebGL without a graphics card, and all else without WebGL."""
FEW_PROCESSES = ("--renderer-process-limit=1", "--disable-site-isolation-trials")
READS_BACK = "GPU stall due to ReadPixels"
"""What it warns of then."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser, and patience with a page on a busy machine."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *WEBGL, *FEW_PROCESSES])
        yield browser
        browser.close()


def expect(it: Any) -> Any:
    """Playwright's assertions, which wait until they hold."""
    from playwright.sync_api import expect

    return expect(it)


def until(page: Any, condition: str) -> None:
    """Wait for JavaScript that says true. (Playwright's own wait compiles it in the page, which the page forbids.)"""
    for _ in range(200):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never true: {condition}")
