"""One who clicks: changes of a video's labels as the page sends them."""

from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from getagrip.cli.annotate import MARKS_DATABASE
from getagrip.readers.masks.mask_regions import fill_polygons
from getagrip.studio.project import Project
from getagrip.studio.store.mark_store import MarkStore
from getagrip.studio.store.tasks import Task
from helpers.labelled_scene import HEIGHT, WIDTH, circle, joints

VIDEO = "scene"


FIRST, LAST = 2, 9


TAB = "tab-one-"


def new() -> str:
    return str(uuid.uuid4())


class Clicking:
    """A project, and a grasp that somebody labels in it."""

    def __init__(self, video: Path, folder: Path, who: str = "ann") -> None:
        self.project = Project([Task(VIDEO, VIDEO, video)], MarkStore(folder / MARKS_DATABASE))
        self.about = {"task": VIDEO, "annotator": who, "grasp": new()}
        start = {"start": FIRST, "side": "left", "category": "disc"}
        for sets in (start, {"end": LAST}):
            self.project.change(self.about | {"change": new(), "mark": self.about["grasp"], "tab": TAB, "set": sets})

    def change(self, frame: int, sets: object, tab: str = TAB) -> dict[str, Any]:
        return self.about | {"change": new(), "tab": tab, "frame": frame, "set": sets}

    def click(self, frame: int, tab: str = TAB, **sets: Any) -> dict[str, Any]:
        return self.project.label(self.change(frame, sets, tab))

    def undo(self, tab: str = TAB) -> dict[str, Any]:
        return self.project.unlabel(self.about | {"change": new(), "tab": tab})

    def state(self) -> dict[str, Any]:
        return self.project.labels(self.about)

    def labels(self) -> list[dict[str, Any]]:
        return self.state()["keyframes"]

    def label(self, frame: int) -> None:
        """All that there is to be clicked on a frame."""
        self.click(frame, joints={str(n): point for n, point in enumerate(joints(frame))}, outlines=disc(frame))

    def work(self, what: str, **about: Any) -> dict[str, Any]:
        """Have something done; the job once it is over."""
        self.project.work(self.about | {"work": what} | about)
        job = self.project.labelling.background.job(self.about["grasp"])
        assert job is not None
        for _ in range(3000):
            if job.state not in ("waiting", "running"):
                break
            time.sleep(0.02)
        return dict(self.state()["job"])


def disc(frame: int, closed: bool = True) -> dict[str, Any]:
    return {"the-disc": {"of": "object", "closed": closed, "points": circle(frame)}}


def filled(outlines: list[Any]) -> np.ndarray:
    flat = [np.ravel(shape).tolist() for shape in outlines]
    return fill_polygons(Path(), "", flat, (WIDTH, HEIGHT))


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())
