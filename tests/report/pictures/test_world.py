"""A timeline in the world: all is in the picture, what lies still stays where it is, the bar says what is when."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.report.film import CAPTION_HEIGHT_PX, FILM_PANEL_PX, FilmStage, _timeline_frames, draw_segment_bar
from getagrip.report.pictures.panels import INK_COLOUR, STATE_COLOURS
from getagrip.report.pictures.result_view import View
from getagrip.result import SegmentResult
from helpers.pages import pixels_of
from helpers.scenes import LIES, by_other_hand, perfect, timeline

SIZE = 160


def given() -> View:
    clip, masks = timeline()
    return View.of(perfect(clip), clip, masks)


def test_hand_and_object_are_in_the_picture_and_lie_still() -> None:
    view = given()
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
    view = given()
    assert view.clip.world is not None
    lost = replace(view.clip.world, up=None, support=None)
    stage = FilmStage.of(replace(view, clip=replace(view.clip, world=lost)), SIZE)
    assert stage.ground == ()
    assert stage.picture(0).std() > 0.0


def test_the_bar_has_each_segment_and_a_mark() -> None:
    view = given()
    segments = view.clip.segments[1:]  # what comes before is unknown
    view = replace(view, clip=replace(view.clip, segments=segments))
    bar = draw_segment_bar(view, 3, (300, 30))
    assert bar.shape == (30, 300, 3)
    for state in ("unknown", "contact", "grasp"):
        assert pixels_of(bar, STATE_COLOURS[state]) > 100
    marked = np.flatnonzero((bar[0] == [*bytes.fromhex(INK_COLOUR[1:])]).all(axis=1))
    assert abs(marked.mean() - 300 * 3.5 / len(view.clip)) < 1.0


def test_the_bar_says_which_grasp_was_followed_by_its_masks_only() -> None:
    view = given()
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
    picture = next(_timeline_frames(given()))
    assert picture.shape == (FILM_PANEL_PX + 2 * CAPTION_HEIGHT_PX, 2 * FILM_PANEL_PX, 3)
    assert pixels_of(picture, STATE_COLOURS["static"]) > 1000
