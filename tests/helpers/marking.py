"""Marks as the page makes them."""

from __future__ import annotations

import uuid
from typing import Any

from getagrip.studio.project import Project

VIDEO = "P01_101"


def new() -> str:
    return str(uuid.uuid4())


def change(
    mark: str, sets: dict[str, Any], who: str = "ann", task: str = VIDEO, tab: str = "tab-one-"
) -> dict[str, Any]:
    return {"change": new(), "mark": mark, "task": task, "annotator": who, "tab": tab, "set": sets}


def undo(who: str = "ann", task: str = VIDEO, tab: str = "tab-one-") -> dict[str, Any]:
    return {"change": new(), "task": task, "annotator": who, "tab": tab}


def grasp(project: Project, start: int, end: int, who: str = "ann", task: str = VIDEO, **more: Any) -> str:
    mark = new()
    project.change(change(mark, {"start": start, "side": "left", "category": "mug", **more}, who, task))
    project.change(change(mark, {"end": end}, who, task))
    return mark
