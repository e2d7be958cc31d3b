"""The real input, end to end: HOT3D's raw sample files to clips, reconstructions and scores."""

from __future__ import annotations

from pathlib import Path

import pytest

from getagrip.cli import main
from getagrip.evaluation import evaluate_result
from helpers.paths import DATA, needs

HOT3D = DATA / "hot3d"
HOLDS = ("P0003--c701bd11--coffee_pot--left", "P0003--c701bd11--mug_white--right", "P0002--273c2819--mouse--right")
"""A pot lifted to pour, a mug held still on the table, a mouse moved about."""


@needs(HOT3D)
@pytest.mark.slow
def test_the_three_holds_are_reconstructed(tmp_path: Path) -> None:
    clips, results = tmp_path / "clips", tmp_path / "results"
    assert main(["import", "hot3d", str(HOT3D), "--out", str(clips)]) == 0
    assert main(["reconstruct", str(clips), "--out", str(results), "--workers", "1"]) == 0
    for hold in HOLDS:
        metrics = evaluate_result(results / hold, clips)["metrics"]
        assert metrics["add_success"] == 1.0, (hold, metrics["add_mm"])
        assert metrics["iou_full"] > 0.95, (hold, metrics["iou_full"])
