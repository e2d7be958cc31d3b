"""The report is drawn for every kind of result, and the demo goes the whole way."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.clip import Clip, Masks, read_clip
from getagrip.commands import demo
from getagrip.datasets.synthetic.scene import make_scene, synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.result import Axis, Candidates, Reconstruction, read_result
from getagrip.view.report import write_report


@lru_cache
def given() -> tuple[Clip, Masks, Axis]:
    options = SceneOptions(frames=6, scale="free")
    clip, masks = synthesise("mug", 0, options)
    return clip, masks, make_scene("mug", 0, options).axis


def result_of(clip: Clip, axis: Axis | None) -> Reconstruction:
    """The truth as if it had been found."""
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return Reconstruction(
        clip=clip.name,
        method="static" if axis is None else "one-dof",
        frames=clip.frames,
        T_hand_obj=T,
        scale=clip.truth.scale,
        iou=np.linspace(0.5, 1.0, len(clip)),
        axis=axis,
        candidates=Candidates(T[None], np.ones(1), np.ones(1)),
        energy={"total": 1.0},
        status="converged",
        ambiguous=True,
        seconds={"total": 0.5},
    )


def drawn(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture


@pytest.mark.slow
def test_every_part_of_the_picture_is_drawn(tmp_path: Path) -> None:
    clip, masks, axis = given()
    metrics = {"add_mm": 1.0, "add_sym_mm": 1.0, "rotation_sym_deg": 2.0}
    picture = drawn(write_report(result_of(clip, axis), clip, masks, tmp_path / "report.png", metrics))
    height, width, _ = picture.shape
    assert min(height, width) > 1000
    # No row of tiles and no plot is empty, nor do their contents touch the picture's border.
    for band in np.array_split(picture, 8):
        assert band.std() > 2.0
    border = np.concatenate([picture[:5].reshape(-1, 3), picture[-5:].reshape(-1, 3), picture[:, -5:].reshape(-1, 3)])
    assert (border == 255).all()


@pytest.mark.parametrize("with_masks", [True, False])
def test_results_without_axis_truth_masks_or_many_frames(with_masks: bool, tmp_path: Path) -> None:
    clip, masks, _ = given()
    two = clip.take(np.array([1, 4]))
    result = result_of(two, None)
    blind = replace(clip, truth=None)
    report = write_report(result, blind, masks if with_masks else None, tmp_path / "report.png")
    assert drawn(report).std() > 5.0


def test_an_empty_image_is_named(tmp_path: Path) -> None:
    clip, masks, axis = given()
    image = tmp_path / "clip" / "frames" / f"{clip.frames[0]}.jpg"
    image.parent.mkdir(parents=True)
    image.touch()
    with pytest.raises(InputError, match=image.name):
        write_report(result_of(clip, axis), replace(clip, folder=tmp_path / "clip"), masks, tmp_path / "report.png")
    assert not (tmp_path / "report.png").exists()


def test_a_result_of_another_clip_is_refused(tmp_path: Path) -> None:
    clip, masks, axis = given()
    result = replace(result_of(clip, axis), frames=tuple(f"x{n}" for n in range(6)))
    with pytest.raises(InputError, match="x0"):
        write_report(result, clip, masks, tmp_path / "report.png")
    assert not (tmp_path / "report.png").exists()


@pytest.mark.slow
def test_the_demo_finds_the_mug_and_can_be_run_again(tmp_path: Path) -> None:
    for _ in range(2):
        demo.run(tmp_path)
    name = demo.clip_name(demo.CATEGORY, demo.SEED, demo.CLIP)
    clip = read_clip(tmp_path / "clips" / name)
    result, record = read_result(tmp_path / name)
    assert result.clip == clip.name
    assert record["metrics"]["add_success"] == 1.0
    assert drawn(tmp_path / "report.png").std() > 5.0
