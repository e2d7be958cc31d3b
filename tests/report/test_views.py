"""Reports of clips with views show what each camera sees, and that of a clip without is as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from getagrip.cli import main
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate
from getagrip.report.film import CAPTION_HEIGHT_PX, FILM_PANEL_PX, FilmLayout, write_film
from getagrip.report.pages.result_page import describe_result
from getagrip.report.pages.scene_data import constant_arrays, draw_page_frame
from getagrip.report.pages.viewer import ViewerLibrary, group_entries
from getagrip.report.pictures.contact_colours import subdivide_object
from getagrip.report.pictures.panels import CROP_MARGIN_FACTOR, RESULT_COLOUR
from getagrip.report.pictures.result_picture import report_figure
from getagrip.report.pictures.result_view import View, candidate_views
from getagrip.report.pictures.stored_results import WINDOW_MARGIN_FACTOR, draw_overlay, smooth_windows
from helpers.environment import Run
from helpers.pages import pixels_of
from helpers.views import GREY, LACKED, NAMES, write_viewed_clip, write_viewed_result


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> View:
    return View.of(*write_viewed_clip(tmp_path_factory.mktemp("views") / "clip"))


def test_a_view_is_the_same_scene_from_another_camera(view: View) -> None:
    """Hand, object, axis and truth are where they are; each camera has its masks, in the frames that are asked for."""
    some = view.at(view.result.frames[1:])
    for name, camera in zip(NAMES, view.cameras, strict=True):
        seen = some.in_each_view()[name]
        assert seen.masks is not None
        for n in (0, 1):
            T = camera.T_view_cam[n + 1]
            np.testing.assert_allclose(seen.hand(n), se3.transform(T, view.hand(n + 1)))
            np.testing.assert_allclose(seen.object(n), se3.transform(T, view.object(n + 1)))
            true = seen.true()
            assert true is not None
            np.testing.assert_allclose(true.object(n), seen.object(n), atol=1e-9)
        assert seen.measured_iou().min() > 0.97
        assert seen.in_each_view() == {}


def test_one_camera_can_be_chosen(view: View) -> None:
    assert view.seen_by("view3").clip.name.endswith("/views/view3")
    assert view.seen_by("camera").clip is view.clip
    assert not view.seen_by("camera").cameras
    with pytest.raises(UsageError, match="camera or view2 or view3"):
        view.seen_by("view4")


def test_the_iou_of_each_view_is_a_metric(view: View) -> None:
    clip = replace(view.clip, truth=None)
    evaluation = evaluate(view.result, clip, view.masks)
    for name, seen in view.in_each_view().items():
        values = seen.measured_iou()
        assert evaluation.per_frame[f"iou_full:{name}"] == pytest.approx(values.tolist())
        assert evaluation.iou_of_views[name] == pytest.approx(values.mean())
    off = replace(view.result, T_hand_obj=view.result.T_hand_obj @ se3.rigid(None, np.array([0.05, 0.0, 0.0])))
    assert max(evaluate(off, clip, view.masks).iou_of_views.values()) < 0.8
    alone = replace(clip, folder=None)
    assert evaluate(view.result, alone, view.masks).iou_of_views == {}


def test_the_picture_has_a_row_for_each_view(view: View) -> None:
    words = [text.get_text() for text in report_figure(view.result, view.clip, view.masks).texts]
    assert [text.split(",")[0] for text in words if text.startswith("view")] == [*NAMES]
    own = report_figure(view.result, replace(view.clip, folder=None), view.masks)
    assert not any(text.get_text().startswith("view") for text in own.texts)


def test_pictures_of_a_film_fill_the_width_of_two() -> None:
    for panels, (columns, rows) in {2: (2, 1), 3: (2, 2), 4: (2, 2), 5: (3, 2), 9: (3, 3), 65: (9, 8)}.items():
        layout = FilmLayout.of(panels)
        assert (layout.columns, layout.height // layout.panel) == (columns, rows)
        assert layout.width == layout.columns * layout.panel == pytest.approx(2 * FILM_PANEL_PX, abs=40)
    layout = FilmLayout.of(3)
    joined = layout.joined([np.full((layout.panel, layout.panel, 3), tone, np.uint8) for tone in (10, 20, 30)])
    assert [int(joined[y, x, 0]) for y in (0, -1) for x in (0, -1)] == [10, 20, 30, 0xF4]


@pytest.mark.slow
def test_a_film_shows_every_camera_or_the_chosen_one(view: View, tmp_path: Path) -> None:
    layout = FilmLayout.of(4)
    for name, one in (("all.mp4", view), ("one.mp4", view.seen_by("view2"))):
        with av.open(str(write_film(one, tmp_path / name))) as film:
            frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(film.streams.video[0])]
        assert len(frames) == len(view.clip)
        assert frames[0].shape[:2] == ((2 if one is view else 1) * FILM_PANEL_PX + CAPTION_HEIGHT_PX, layout.width)
        cameras = {"camera": view, **view.in_each_view()} if one is view else {"view2": one}
        for k, (camera, seen) in enumerate(cameras.items()):
            top, left = (FILM_PANEL_PX * at for at in divmod(k, 2))
            picture = frames[0][top : top + FILM_PANEL_PX, left : left + FILM_PANEL_PX]
            middle = np.abs(
                picture[60:] - draw_overlay(seen, 0, smooth_windows(seen, FILM_PANEL_PX), 0)[60:].astype(int)
            )
            assert middle.mean() < 4.0, camera


def test_a_page_has_the_footage_and_the_camera_of_each_view(view: View) -> None:
    for name, seen in view.in_each_view().items():
        windows = smooth_windows(seen, 320)
        shown = draw_overlay(seen, 0, windows, 0)
        assert np.median(shown) == GREY[name]
        assert pixels_of(shown, RESULT_COLOUR) > 50
        drawn: Any = draw_page_frame(seen, LACKED, windows, LACKED, [seen], 0.876)
        assert (drawn["met"], drawn["others"]) == ("IOU 88 %", [drawn["outlines"]["object"]])
    arrays = constant_arrays(candidate_views(view), subdivide_object(view))
    for k, camera in enumerate(view.cameras):
        np.testing.assert_allclose(arrays["T_cam_views"][:, k], camera.T_cam_view, atol=1e-6)
        corner = arrays["camera_corners"][1 + k, 2]
        np.testing.assert_allclose(camera.K[0] @ corner, [*camera.size, 1.0], atol=1e-4)
    said = describe_result(view, "", evaluate(view.result, view.clip, view.masks), {})
    assert said["views"] == [*NAMES]
    assert "IOU in 2 further views" in [one["name"] for one in said["main"]]
    alone = View.of(view.result, replace(view.clip, folder=None), view.masks)
    assert not {"T_cam_views", "camera_corners"} & {*constant_arrays([alone], subdivide_object(alone))}


def test_the_served_page_has_frames_of_each_view(tmp_path: Path) -> None:
    problems: list[Exception] = []
    library = ViewerLibrary(group_entries([write_viewed_result(tmp_path)], [], None, problems.append), problems.append)
    assert not problems
    shown: Any = library.entry(0)
    assert [column["views"] for column in shown["columns"]] == [[*NAMES]]
    views: Any = library.frame(0, 0, 0, 2)["views"]
    assert all(one["met"].startswith("IOU") and one["picture"] and one["outlines"]["object"] for one in views)


@pytest.mark.slow
def test_report_names_the_views_that_there_are(tmp_path: Path, run: Run) -> None:
    folder = write_viewed_result(tmp_path)
    assert "--mp4" in run("report", folder, "--view", "view2")[2]
    code, _, said = run("report", folder, "--mp4", "--view", "nobody")
    assert code == 1
    assert "camera or view2 or view3" in said
    assert main(["report", str(folder), "--mp4", "--view", "view3"]) == 0


def test_a_view_that_looks_away_shows_its_whole_images(view: View) -> None:
    """What is behind a camera is nowhere in its images."""
    camera = view.cameras[0]
    away = replace(camera, T_cam_view=camera.T_cam_view @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    seen = replace(view, cameras=(away,)).in_each_view()["view2"]
    crops = smooth_windows(replace(seen, masks=None), 320)
    np.testing.assert_allclose(crops.side, 160.0 * CROP_MARGIN_FACTOR * WINDOW_MARGIN_FACTOR)
    drawn: Any = draw_page_frame(seen, 0, crops, 0)
    assert drawn["outlines"]["object"] == ""
