"""The report is drawn for every kind of result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Masks
from getagrip.errors import InputError
from getagrip.geometry import mesh as meshes
from getagrip.geometry.mesh import Mesh
from getagrip.report.pictures.panels import AXIS_COLOUR, RESULT_COLOUR, TRUTH_COLOUR
from getagrip.report.pictures.result_picture import N_REPORT_TILES, report_figure, write_report
from getagrip.report.pictures.result_view import View
from getagrip.result import Axis
from getagrip.result.findings import ASSUMED_MESH, Probability
from getagrip.synthetic.scene_options import SceneOptions
from helpers.pages import panel, pixels, pixels_of, read_picture, texts
from helpers.results import true_result
from helpers.scenes import scene_with_axis


def given() -> tuple[Clip, Masks, Axis]:
    return scene_with_axis("mug", 0, SceneOptions(frames=6, scale="free", size=(320, 240), focal=300.0))


@pytest.mark.slow
def test_every_part_of_the_picture_is_drawn(tmp_path: Path) -> None:
    clip, masks, axis = given()
    metrics = {"add_mm": 1.25, "add_sym_mm": 1.0, "rotation_sym_deg": 2.0}
    sure, unsure = Probability(0.996, "", (ASSUMED_MESH,)), Probability(0.3, "")
    result = replace(true_result(clip, axis), probability_right=sure, probability_right_in_camera=unsure)
    figure = report_figure(result, clip, masks, metrics)
    assert len(figure.axes) == 3 * N_REPORT_TILES + 2
    assert texts(figure) >= {
        clip.name,
        "input and fitted contour",
        "75.0 %",
        "> 99 %, 30 %",
        f"{result.message}  ·  probably looks right",
        "1.2 mm",
        "2.0°",
        "angle of the object about the axis [°]",
    }
    picture = pixels(figure)
    tiles = [panel(picture, axes) for axes in figure.axes[:-2]]
    for over, camera, side in zip(
        tiles[:N_REPORT_TILES], tiles[N_REPORT_TILES : 2 * N_REPORT_TILES], tiles[2 * N_REPORT_TILES :], strict=True
    ):
        assert pixels_of(over, RESULT_COLOUR) > 100  # the fitted contour
        assert all(pixels_of(tile, AXIS_COLOUR) > 50 for tile in (camera, side))
    angle, iou = (panel(picture, axes) for axes in figure.axes[-2:])
    assert pixels_of(angle, TRUTH_COLOUR) > 50
    assert pixels_of(iou, RESULT_COLOUR) > 50
    border = np.concatenate([picture[:5].reshape(-1, 3), picture[-5:].reshape(-1, 3), picture[:, -5:].reshape(-1, 3)])
    assert (border == 255).all()  # nothing is cut off
    written = read_picture(write_report(result, clip, masks, tmp_path / "report.png", metrics))
    np.testing.assert_array_equal(written, picture)


@pytest.mark.parametrize("with_masks", [True, False])
@pytest.mark.slow
def test_results_without_axis_truth_masks_or_many_frames(with_masks: bool) -> None:
    clip, masks, _ = given()
    result = true_result(clip.take(np.array([1, 4])), None)
    figure = report_figure(result, replace(clip, truth=None), masks if with_masks else None)
    assert [axes.get_title() for axes in figure.axes[:2]] == [clip.frames[1], clip.frames[4]]
    assert len(figure.axes) == 3 * 2 + 2
    assert "rotation in the hand since the start [°]" in texts(figure)
    assert "ground truth" not in texts(figure)
    tile = panel(pixels(figure), figure.axes[0])
    assert pixels_of(tile, RESULT_COLOUR) > 0
    assert (pixels_of(tile, "#7e9eb8") > 0) == with_masks  # the observed mask


@pytest.mark.slow
def test_triangles_that_share_no_corners_are_drawn_by_a_mesh_of_fewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have three corners each, so that even 100 000 of them are too many."""
    clip, masks, axis = given()
    whole = clip.mesh
    soup = Mesh(whole.vertices[whole.faces].reshape(-1, 3), np.arange(whole.faces.size).reshape(-1, 3))
    monkeypatch.setattr(meshes, "MAX_MESH_FACES", len(soup.faces))
    clip = replace(clip, mesh=soup)
    result = true_result(clip, axis)
    drawn = View.of(result, clip, masks).clip.mesh
    assert len(drawn.vertices) <= len(soup.faces) < len(soup.vertices)
    assert write_report(result, clip, masks, tmp_path / "report.png").stat().st_size > 10_000


def test_a_result_of_a_method_that_is_not_installed_is_shown(tmp_path: Path) -> None:
    clip, masks, axis = given()
    result = replace(true_result(clip, axis), method="foo")
    assert write_report(result, clip, masks, tmp_path / "report.png").stat().st_size > 10_000


def test_an_empty_image_is_named(tmp_path: Path) -> None:
    clip, masks, axis = given()
    image = tmp_path / "clip" / "frames" / f"{clip.frames[0]}.jpg"
    image.parent.mkdir(parents=True)
    image.touch()
    with pytest.raises(InputError, match=image.name):
        write_report(true_result(clip, axis), replace(clip, folder=tmp_path / "clip"), masks, tmp_path / "report.png")
    assert not (tmp_path / "report.png").exists()


def test_a_result_of_another_clip_is_refused(tmp_path: Path) -> None:
    clip, masks, axis = given()
    result = replace(true_result(clip, axis), frames=tuple(f"x{n}" for n in range(6)))
    with pytest.raises(InputError, match="x0"):
        write_report(result, clip, masks, tmp_path / "report.png")
    assert not (tmp_path / "report.png").exists()
