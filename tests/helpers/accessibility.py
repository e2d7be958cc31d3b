"""What axe-core says of a page: contrast, labels and roles."""

from __future__ import annotations

from typing import Any

STANDARDS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]


def faults(page: Any) -> list[str]:
    """What axe-core says is wrong with what is on the page now."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page, options={"runOnly": {"type": "tag", "values": STANDARDS}}).response["violations"]
    return [f"{one['id']}: {node['target']} {node['any'][:1]}" for one in found for node in one["nodes"]]
