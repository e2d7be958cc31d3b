"""A browser without a window, where there is one on the machine."""

from __future__ import annotations

import shutil
from contextlib import suppress
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


class Chromium:
    """One browser for all tests of a process, as it takes long to start, and another once it or its driver has died."""

    def __init__(self) -> None:
        self._started: Any = None
        self._browser: Any = None

    def get(self) -> Any:
        """The browser that answers, with patience for a page on a busy machine."""
        from playwright.sync_api import Error, expect, sync_playwright

        if self._browser is not None:
            try:
                self._browser.new_context().close()
            except Error:
                self.close()
        if self._browser is None:
            expect.set_options(timeout=PATIENCE)
            self._started = sync_playwright().start()
            arguments = ["--no-sandbox", *WEBGL, *FEW_PROCESSES]
            try:
                self._browser = self._started.chromium.launch(executable_path=CHROMIUM, args=arguments)
            except Error:
                self.close()
                raise
        return self._browser

    def close(self) -> None:
        """End the browser and its driver, whether or not they still live."""
        from playwright.sync_api import Error

        started, browser, self._started, self._browser = self._started, self._browser, None, None
        with suppress(Error):
            if browser is not None:
                browser.close()
        if started is not None:
            started.stop()


def close(profile: Any) -> None:
    """Close a profile, unless the browser has died since a test's end: the next one gets another."""
    from playwright.sync_api import Error

    with suppress(Error):
        profile.close()


def expect(it: Any) -> Any:
    """Playwright's assertions, which wait until they hold."""
    from playwright.sync_api import expect

    return expect(it)


def until(page: Any, condition: str) -> None:
    """Wait for JavaScript that says true. (Playwright's own wait compiles it in the page, which the page forbids.)"""
    for _ in range(PATIENCE // 50):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never true: {condition}")
