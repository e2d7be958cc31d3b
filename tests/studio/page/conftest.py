"""A profile of the browser for each test of the page, and a grasp to label."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.studio.masks import propagate_clip
from getagrip.studio.store.tasks import Task
from helpers.annotation import FIRST_FRAME, LAST_FRAME, MARK, Served, close


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:
    """A browser's profile: its tabs share what the page keeps."""
    made = browser.new_context(viewport={"width": 1300, "height": 860}, accept_downloads=True)
    yield made
    close(made)


@pytest.fixture
def served(scene_video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A video in which a grasp is marked. Masks are propagated at a quarter of the size, which is faster."""
    monkeypatch.setattr(propagate_clip, "OBJECT_WORKING_SIZE_PX", 50.0)
    tasks = [Task("scene", "scene", scene_video), Task("another", "another", scene_video)]
    made = Served(tasks, tmp_path / DATABASE)
    about = {"mark": MARK, "task": "scene", "annotator": "ann", "tab": "a-tab-of-old"}
    sets = ({"start": FIRST_FRAME, "side": "left", "category": "disc"}, {"end": LAST_FRAME})
    for n, one in enumerate(sets):
        made.project.change(about | {"change": f"change-{n}", "set": one})
    yield made
    made.stop()
