"""Films show every frame of a result over its image and from the side, or a timeline in the world with its segments."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.report.film import (
    CAPTION_HEIGHT_PX,
    FILM_PANEL_PX,
    FilmLayout,
    FilmStage,
    _timeline_frames,
    draw_segment_bar,
    write_film,
)
from getagrip.report.pages.scene_data import constant_arrays
from getagrip.report.pictures.contact_colours import subdivide_object
from getagrip.report.pictures.panels import AXIS_COLOUR, HAND_LINE_COLOUR, INK_COLOUR, RESULT_COLOUR, STATE_COLOURS
from getagrip.report.pictures.result_view import View, candidate_views
from getagrip.report.pictures.stored_results import draw_overlay, draw_side_view, smooth_track, smooth_windows
from getagrip.result import Axis, SegmentResult
from helpers.pages import pixels_of
from helpers.scenes import FRAMES, LIES, by_other_hand, egg_and_mug, perfect, timeline


def given() -> View:
    clip, masks = egg_and_mug()
    axis = Axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 0.4, FRAMES))
    return View.of(replace(perfect(clip), axis=axis, method="one-dof"), clip, masks)


@pytest.mark.slow
def test_a_film_has_all_frames_at_the_clips_rate(tmp_path: Path) -> None:
    view = given()
    with av.open(str(write_film(view, tmp_path / "film.mp4"))) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.average_rate == Fraction(30)
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
    assert len(frames) == FRAMES
    assert frames[0].shape == (FILM_PANEL_PX + CAPTION_HEIGHT_PX, 2 * FILM_PANEL_PX, 3)
    crops = smooth_windows(view, FILM_PANEL_PX)
    for n in (0, FRAMES - 1):
        expected = np.concatenate([draw_overlay(view, n, crops, n), draw_side_view(view, n, crops, n)], axis=1)
        assert np.abs(frames[n][:FILM_PANEL_PX].astype(float) - expected).mean() < 4.0  # colours are compressed
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_stills_show_contours_and_axis() -> None:
    view = given()
    crops = smooth_windows(view, FILM_PANEL_PX)
    over = draw_overlay(view, 2, crops, 2)
    assert pixels_of(over, RESULT_COLOUR) > 50
    assert pixels_of(over, HAND_LINE_COLOUR) > 30
    assert pixels_of(draw_side_view(view, 2, crops, 2), AXIS_COLOUR) > 20


def test_an_object_is_shown_in_its_own_colours() -> None:
    """Red below and blue above its middle, from the side and in the arrays of a page."""
    view = given()
    high = view.clip.mesh.vertices[:, 2] > view.clip.mesh.centre[2]
    colours = np.where(high[:, None], np.array([0, 0, 255], np.uint8), np.array([255, 0, 0], np.uint8))
    painted = replace(view, clip=replace(view.clip, mesh=replace(view.clip.mesh, colours=colours)))
    crops = smooth_windows(view, FILM_PANEL_PX)
    for one, many in ((view, False), (painted, True)):
        picture = draw_side_view(one, 2, crops, 2).astype(int)
        assert ((np.abs(picture[..., 0] - picture[..., 2]) > 150).sum() > 500) == many
    surface = subdivide_object(painted)
    assert surface.colours is not None
    at = np.abs(surface.vertices[:, 2] - painted.clip.mesh.centre[2]) > 0.01
    above = surface.vertices[at, 2] > painted.clip.mesh.centre[2]
    np.testing.assert_array_equal(surface.colours[at], np.where(above[:, None], [0, 0, 255], [255, 0, 0]))
    arrays = constant_arrays(candidate_views(painted), surface)
    np.testing.assert_array_equal(arrays["object_colours"], surface.colours)
    assert "object_colours" not in constant_arrays(candidate_views(view), subdivide_object(view))


def test_windows_hold_hand_and_masks_and_move_less_than_they() -> None:
    view = given()
    jump = view.clip.hand.T_cam_hand.copy()
    jump[2, :2, 3] += 0.05
    shaken = View.of(replace(view.result, T_cam_hand=jump), view.clip, view.masks)
    still, moved = smooth_windows(view, 100), smooth_windows(shaken, 100)
    for n in range(FRAMES):
        hand = shaken.hand(n)
        uv = hand[:, :2] / hand[:, 2:] * 400.0 + [160.0, 120.0]
        assert (uv > moved.corner[n]).all()
        assert (uv < moved.corner[n] + moved.side).all()
    middles = [crops.corner + crops.side / 2.0 for crops in (still, moved)]
    steps = [np.linalg.norm(np.diff(middle, axis=0), axis=1).max() for middle in middles]
    assert steps[1] < 0.5 * 0.05 * 400.0 / 0.5  # half of the hand's own jump


@pytest.mark.parametrize("over", [0.1, 2.0, 40.0])
def test_tracks_are_smoothed_as_scipy_does(over: float) -> None:
    from scipy.ndimage import gaussian_filter1d

    track = np.random.default_rng(0).normal(size=(12, 2))
    np.testing.assert_allclose(
        smooth_track(track, over), gaussian_filter1d(track, over, axis=0, mode="nearest"), atol=1e-12
    )


SIZE = 160


def timeline_view() -> View:
    clip, masks = timeline()
    return View.of(perfect(clip), clip, masks)


def test_hand_and_object_are_in_the_picture_and_lie_still() -> None:
    view = timeline_view()
    world = view.clip.world
    assert world is not None
    stage = FilmStage.of(view, SIZE)
    places = []
    for n in range(len(view.clip)):
        T = stage.T_eye_world @ world.T_world_cam[n]
        seen = se3.transform(T, np.concatenate([view.hand(n), view.object(n)]))
        uv = project(stage.K, seen)
        assert seen[:, 2].min() > 0.0
        assert uv.min() >= 0.0
        assert uv.max() <= SIZE
        places.append(project(stage.K, se3.transform(T, view.object(n))))
    np.testing.assert_allclose(places[:LIES], [places[0]] * LIES, atol=1e-6)
    assert stage.ground  # the clip knows its support
    pictures = [stage.picture(n) for n in (0, LIES)]
    assert pictures[0].shape == (SIZE, SIZE, 3)
    assert (pictures[0] != pictures[1]).any()  # the hand has come


def test_without_up_there_is_no_ground() -> None:
    view = timeline_view()
    assert view.clip.world is not None
    lost = replace(view.clip.world, up=None, support=None)
    stage = FilmStage.of(replace(view, clip=replace(view.clip, world=lost)), SIZE)
    assert stage.ground == ()
    assert stage.picture(0).std() > 0.0


def test_the_bar_has_each_segment_and_a_mark() -> None:
    view = timeline_view()
    segments = view.clip.segments[1:]  # what comes before is unknown
    view = replace(view, clip=replace(view.clip, segments=segments))
    bar = draw_segment_bar(view, 3, (300, 30))
    assert bar.shape == (30, 300, 3)
    for state in ("unknown", "contact", "grasp"):
        assert pixels_of(bar, STATE_COLOURS[state]) > 100
    marked = np.flatnonzero((bar[0] == [*bytes.fromhex(INK_COLOUR[1:])]).all(axis=1))
    assert abs(marked.mean() - 300 * 3.5 / len(view.clip)) < 1.0


def test_the_bar_says_which_grasp_was_followed_by_its_masks_only() -> None:
    view = timeline_view()
    first = view.clip.frames[view.clip.segments[2].first]
    records = (SegmentResult(state="grasp", first=first, last=first, by_masks=True),)
    followed = replace(view, result=replace(view.result, segments=records))
    plain, marked = (draw_segment_bar(one, 0, (900, 30)) for one in (view, followed))
    half = 450
    assert (plain[:, half:] != marked[:, half:]).any()
    np.testing.assert_array_equal(plain[:, : half // 2], marked[:, : half // 2])


def test_the_other_hand_is_drawn_where_it_is_known() -> None:
    clip, masks = by_other_hand()
    view = View.of(perfect(clip), clip, masks)
    assert [len(view.hands(n)) for n in (1, 2)] == [1, 2]
    stage = FilmStage.of(view, SIZE)
    alone = replace(stage, view=replace(view, clip=replace(clip, other_hand=None)))
    assert [(stage.picture(n) != alone.picture(n)).any() for n in (1, 2)] == [False, True]


def test_a_film_of_a_timeline_has_a_bar_of_segments() -> None:
    picture = next(_timeline_frames(timeline_view(), FilmLayout.of(2)))
    assert picture.shape == (FILM_PANEL_PX + 2 * CAPTION_HEIGHT_PX, 2 * FILM_PANEL_PX, 3)
    assert pixels_of(picture, STATE_COLOURS["static"]) > 1000
