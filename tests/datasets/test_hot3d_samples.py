"""HOT3D's real sample files, read once: clips, the stable grasp among them, reconstructions and their errors."""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy.spatial import cKDTree

from getagrip.cli import main
from getagrip.clip import FINGERS, Clip, read_clip, read_masks
from getagrip.evaluation import evaluate_result
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.stable import segment
from helpers.paths import DATA, needs

HOT3D = DATA / "hot3d"
POT = "P0003--c701bd11--coffee_pot--left"
HOLDS = {POT: 34, "P0003--c701bd11--mug_white--right": 34, "P0002--273c2819--mouse--right": 15}
"""Frames of a pot lifted to pour, of a mug held still on the table, of a mouse moved about."""

pytestmark = [needs(HOT3D), pytest.mark.slow]


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hot3d") / "clips"
    assert main(["import", "hot3d", str(HOT3D), "--out", str(folder)]) == 0
    return folder


def held(clips: Path) -> dict[str, Clip]:
    return {path.name: read_clip(path) for path in clips.iterdir() if path.is_dir()}


def test_three_fingertips_and_more_are_at_the_object(clips: Path) -> None:
    found = held(clips)
    assert {name: len(clip) for name, clip in found.items()} == HOLDS
    for clip in found.values():
        assert read_masks(clip).object.any(axis=(1, 2)).all()
        assert clip.truth is not None
        assert clip.truth.scale == 1.0
        hand = se3.transform(clip.truth.T_cam_hand, clip.truth.hand_vertices)
        corners = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices[clip.mesh.faces].mean(axis=1))
        for n in (0, len(clip) - 1):
            distance, _ = cKDTree(corners[n]).query(hand[n])
            pads = [distance[clip.hand.regions[finger]].min() for finger in FINGERS]
            assert sorted(pads)[2] < 0.008


@pytest.mark.parametrize("points", ["vertices", "area"])
def test_the_pot_is_held_from_first_to_last_frame(clips: Path, points: str) -> None:
    """The one proper lifted grasp: contact is reliable at 5 mm."""
    pot = held(clips)[POT]
    assert segment(pot, Definition(contact=0.005, points=points))[1] == [(0, 33)]


def test_they_are_reconstructed(clips: Path, tmp_path: Path) -> None:
    assert (
        main(["reconstruct", str(clips), "--out", str(tmp_path), "--workers", "1", "--inits", "20", "--frames", "12"])
        == 0
    )
    for name in HOLDS:
        metrics = evaluate_result(tmp_path / name, clips)["metrics"]
        assert metrics["add_success"] == 1.0, (name, metrics["add_mm"])
        assert metrics["iou_full"] > 0.95, (name, metrics["iou_full"])
