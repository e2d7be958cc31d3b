"""Footage, projects, and one who labels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.studio.masks import propagate_clip
from getagrip.studio.project import Project
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.tasks import Task
from helpers import annotation
from helpers.labelled_scene import write_scene, write_video


@pytest.fixture(scope="session")
def scene_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Footage of a hand with an object."""
    return write_scene(tmp_path_factory.mktemp("video") / f"{annotation.VIDEO}.mp4")


@pytest.fixture
def clicking(scene_video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[annotation.Clicking]:
    """Masks are propagated at a quarter of the size, which is faster."""
    monkeypatch.setattr(propagate_clip, "OBJECT_WORKING_SIZE_PX", 50.0)
    made = annotation.Clicking(scene_video, tmp_path)
    yield made
    made.project.close()


@pytest.fixture(scope="session")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Footage whose frames show their numbers."""
    return write_video(tmp_path_factory.mktemp("video") / f"{annotation.MARKED_VIDEO}.mp4", fps=50)


@pytest.fixture
def project(video: Path, tmp_path: Path) -> Iterator[Project]:
    """A video as a whole, and a candidate in it."""
    name = annotation.MARKED_VIDEO
    candidate = Task("candidate", name, video, 11, 60, "left", "mug", "red mug", contact=20)
    made = Project([Task(name, name, video), candidate], Store(tmp_path / DATABASE))
    yield made
    made.close()
