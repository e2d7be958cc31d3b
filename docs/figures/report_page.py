"""docs/images/report.png, view.png: a page in a browser. Needs playwright and Chromium.

getagrip demo
python docs/figures/report_page.py out/demo/report.html docs/images/report.png
python docs/figures/report_page.py http://127.0.0.1:8770/SECRET/ docs/images/view.png  # as getagrip view has printed
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

WEBGL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main(page: str, picture: Path) -> None:
    """Draw the middle frame of a result's page, or a page of many results as it is."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=WEBGL)
        tab = browser.new_page(viewport={"width": 1240, "height": 1160})
        tab.goto(page if page.startswith("http") else Path(page).absolute().as_uri())
        tab.locator("body[data-ready]").wait_for()
        slider = tab.locator("#slider")
        if slider.count():
            slider.fill(str(int(slider.get_attribute("max") or 0) // 2))
            tab.locator("body[data-complete]").wait_for()
            tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        tab.screenshot(path=picture, full_page=True)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
