"""``getagrip demo --video``: each stage of a draft beside the truth of the video that it was made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.cli.demo_video import measure_draft, run_demo_video
from getagrip.clip import read_clip, write_clip
from getagrip.geometry import se3
from getagrip.io.terminal import cache_folder
from getagrip.synthetic.scene import ground_truth_masks, make_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.synthetic.video import VIDEO_SIZE_PX, at_video_size
from helpers.scenes import perfect

MODELS = cache_folder() / "models"


def test_a_perfect_draft_has_no_errors_and_a_shifted_one_has_its_shift(tmp_path: Path) -> None:
    scene = make_scene("mug", 2, SceneOptions(frames=4))
    shown = at_video_size(scene, VIDEO_SIZE_PX)
    clip = replace(shown.clip, frames=tuple(f"{n:06d}" for n in range(1, 5)))
    clip = read_clip(write_clip(clip, ground_truth_masks(shown), tmp_path / "clip"))
    result = replace(perfect(clip, "draft"), T_cam_hand=clip.hand.T_cam_hand)
    assert measure_draft(scene, clip, result) == {
        "hand found in": "4 of 4 frames",
        "joints of the hand": "0 mm",
        "masks, IOU": "1.00",
        "object, distance of its vertices": "0.0 mm, 0.0 % of its diameter",
        "object, along the ray": "+0.0 mm",
        "object, rotation": "0.0 degrees",
    }
    away = clip.hand.T_cam_hand[:, :3, 3] / np.linalg.norm(clip.hand.T_cam_hand[:, :3, 3], axis=1, keepdims=True)
    farther = se3.rigid(None, 0.02 * away) @ clip.hand.T_cam_hand
    errors = measure_draft(scene, clip, replace(result, T_cam_hand=farther))
    assert errors["object, distance of its vertices"].startswith("20.0 mm")
    assert errors["object, along the ray"].startswith(("+19", "+20"))
    assert errors["object, rotation"] == "0.0 degrees"


@pytest.mark.skipif(not MODELS.is_dir(), reason="needs the hand models: getagrip doctor --fetch hands")
@pytest.mark.long
@pytest.mark.slow
def test_from_pixels_to_3d_on_an_embedded_default(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_demo_video("mug", 2, tmp_path, MODELS, frames=24) == 0
    printed = capsys.readouterr().out
    found, errors = printed.split("beside the truth")
    assert "getagrip draft" in found
    joints, overlap, distance, rotation = (
        float(next(line for line in errors.splitlines() if what in line).split(": ")[1].split()[0])
        for what in ("joints of", "masks", "distance", "rotation")
    )
    assert joints < 90.0
    assert overlap > 0.9
    assert distance < 14.0  # a tenth of the diameter
    assert rotation < 10.0
