"""HOT3D's real sample files, read once: clips, the stable grasp among them, a reconstruction and its errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from getagrip.cli import main
from getagrip.clip import FINGERS, Clip, read_clip, read_masks
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate_result
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import segment
from helpers.environment import DATA, needs

HOT3D = DATA / "hot3d"
POT = "P0003--c701bd11--coffee_pot--left"
HOLDS = {POT: 34, "P0003--c701bd11--mug_white--right": 34, "P0002--273c2819--mouse--right": 15}
"""Frames of a pot lifted to pour, of a mug held still on the table, of a mouse moved about."""

pytestmark = [needs(HOT3D), pytest.mark.slow, pytest.mark.long]


def three_fingertips_and_more_are_at_the_object(clip: Clip) -> None:
    assert read_masks(clip.take(np.arange(0, len(clip), 5))).object.any(axis=(1, 2)).all()
    assert clip.truth is not None
    assert clip.truth.scale == 1.0
    hand = se3.transform(clip.truth.T_cam_hand, clip.truth.hand_vertices)
    corners = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices[clip.mesh.faces].mean(axis=1))
    for n in (0, len(clip) - 1):
        distance, _ = cKDTree(corners[n]).query(hand[n])
        pads = [distance[clip.hand.regions[finger]].min() for finger in FINGERS]
        assert sorted(pads)[2] < 0.008


def test_clips_and_results(tmp_path: Path) -> None:
    """In one test, since reading the samples takes longer than all that is asserted of them."""
    clips = tmp_path / "clips"
    assert main(["import", "hot3d", str(HOT3D), "--out", str(clips)]) == 0
    found = {path.name: read_clip(path) for path in clips.iterdir() if path.is_dir()}
    assert {name: len(clip) for name, clip in found.items()} == HOLDS
    for clip in found.values():
        three_fingertips_and_more_are_at_the_object(clip)
    for points in ("vertices", "area"):  # the one proper lifted grasp; contact is reliable at 5 mm
        assert segment(found[POT], Definition(contact=0.005, points=points))[1] == [(0, 33)]
    quick = ("--workers", "1", "--frames", "12", "--inits", "25", "--sampled-only")
    assert main(["reconstruct", str(clips / POT), "--out", str(tmp_path / "out"), *quick]) == 0
    metrics = evaluate_result(tmp_path / "out" / POT, clips).metrics
    assert metrics["add_success"] == 1.0, metrics["add_mm"]
    assert metrics["iou_full"] > 0.95
