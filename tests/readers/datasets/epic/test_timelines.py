"""EPIC-HIT: its list, EPIC-Fields' cameras in a metric world, and clips with segments."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.readers.datasets.epic import epic_grasps, epic_images, epic_tables
from getagrip.readers.datasets.epic.epic_grasps import EpicGrasps
from helpers.environment import DATA, needs
from helpers.epic_files import V, write_epic, write_timeline

EPIC = DATA / "epic"


@needs(EPIC)
def test_the_real_list() -> None:
    notes: list[str] = []
    found = epic_grasps.read_timelines(
        EPIC / "epic_hit.json", epic_tables.read_grasps(EPIC / "epicgrasps_2431.csv"), notes.append
    )
    assert len(found) == 93
    assert notes == ["epic_hit.json: 3 of 96 timelines are listed twice or empty: skipped"]
    states = Counter(segment.state for timeline in found for segment in timeline.segments)
    assert states == {"static": 135 - 5, "contact": 28, "grasp": 106 - 3}


@pytest.fixture
def T_world_cam() -> Float[ndarray, "90 4 4"]:
    rng = np.random.default_rng(0)
    return se3.rigid(se3.exp_so3(rng.normal(size=(90, 3))), rng.normal(size=(90, 3)))


@pytest.fixture
def root(tmp_path: Path, T_world_cam: ndarray) -> Path:
    write_timeline(write_epic(tmp_path), T_world_cam)
    return tmp_path


def clip_of(root: Path, note: Callable[[str], None] = lambda _: None) -> Clip | None:
    dataset = EpicGrasps(
        csv=root / "grasps.csv", visor=root / "visor", frames=root / "images", timelines=root / "hit.json",
        cameras=root / "cameras", metric=root / "metric",
    )  # fmt: skip
    made = [draft.make() for part in dataset.parts(note) for draft in part.drafts(lambda *_, **__: True, note)]
    return made[0][0] if made and made[0] else None


def test_a_timeline_has_segments_and_the_camera_in_a_metric_world(root: Path, T_world_cam: ndarray) -> None:
    clip = clip_of(root)
    assert clip is not None
    assert clip.world is not None
    numbers = np.array([int(name) for name in clip.frames])
    assert numbers.max() == 1080  # EPIC-Fields has 1000 to 1089, VISOR annotates up to 1080
    np.testing.assert_allclose(clip.world.T_world_cam, T_world_cam[numbers - 1000], atol=1e-9)
    np.testing.assert_array_equal(clip.world.up, [0.0, 0.0, 1.0])
    spans = [(s.state, numbers[s.first], numbers[s.last], s.side) for s in clip.segments]
    assert spans == [("static", 1000, 1019, None), ("contact", 1040, 1060, None), ("grasp", 1062, 1080, "left")]


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("hit.json", lambda c: c[0].update(mp4_name="P01_101_x"), "mp4_name"),
        ("hit.json", lambda c: c[0].update(cat="cup"), "cat"),
        ("hit.json", lambda c: c[0].update(main_side="both"), "main_side"),
        ("hit.json", lambda c: c[0]["segments"][0].update(st=-1), "st"),
        (f"metric/{V}.json", lambda c: c["T"][0].__setitem__(0, 9.0), "T"),
        (f"metric/{V}.json", lambda c: c.update(T=[[1, 2], [3]]), "T"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"frame_0000001003.jpg": [1, 1, 0, 0, 0, 0, 0]}), "images"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"frame_0000001003.jpg": [1, 0, 0, 0, 1e9, 0, 0]}), "away"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"one": []}), "frame"),
    ],
)
def test_broken_files_are_named(
    root: Path, name: str, change: Callable[[Any], None], named: str, refused: Callable[..., str]
) -> None:
    content = json.loads((root / name).read_text())
    change(content)
    (root / name).write_text(json.dumps(content))
    assert named in refused(lambda: clip_of(root), Path(name).name)


def test_videos_without_a_metric_world_are_skipped(root: Path) -> None:
    (root / "metric" / f"{V}.json").unlink()
    notes: list[str] = []
    assert clip_of(root, notes.append) is None
    assert any("1 timelines skipped" in note for note in notes)


def test_a_similarity_is_scale_and_motion(root: Path) -> None:
    scale, T = epic_images.read_metric_similarity(root / "metric" / f"{V}.json")
    assert scale == pytest.approx(0.4)
    assert se3.is_rigid(T[None]).all()
