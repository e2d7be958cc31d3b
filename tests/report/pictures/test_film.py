"""Films show every frame of a result, over its image and turned, as fast as the clip."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from getagrip.report.film import CAPTION_HEIGHT_PX, FILM_PANEL_PX, write_film
from getagrip.report.pictures.panels import AXIS_COLOUR, HAND_LINE_COLOUR, RESULT_COLOUR
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stills import draw_overlay, draw_side_view, smooth_track, smooth_windows
from getagrip.result import Axis
from helpers.pages import pixels_of
from helpers.scenes import FRAMES, egg_and_mug, perfect


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
