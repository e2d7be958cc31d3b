"""Views are read from a clip's folder as they were written; their cameras also alone, without a pixel."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.inputs.added_views import AddedViews
from getagrip.bench.inputs.perturbations import Unchanged
from getagrip.clip import Clip, read_clip, write_clip
from getagrip.clip.views import clip_in_view, find_cameras, masks_in_view, read_views, views_of, with_views
from getagrip.errors import InputError
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import scene


@pytest.fixture
def stored(tmp_path: Path) -> tuple[Clip, Clip]:
    """A clip with two further views in memory, and as it is read from its folder."""
    small = scene("mug", 0, SceneOptions(frames=3, size=(160, 120), focal=150.0))
    clip, masks = AddedViews(3, Unchanged())(*small, 0)
    return clip, read_clip(write_clip(clip, masks, tmp_path / "clip"))


def test_views_are_read_as_they_were_written(stored: tuple[Clip, Clip]) -> None:
    written, clip = stored
    found = read_views(clip)
    assert found is not None
    for one, other in zip(views_of(written), found.each, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.T_cam_view, other.T_cam_view)
        np.testing.assert_array_equal(one.masks.object, other.masks.object)


def test_cameras_are_found_in_memory_and_in_the_folder(stored: tuple[Clip, Clip]) -> None:
    """Masks are read where they are asked for, of the frames that are asked for."""
    written, clip = stored
    assert find_cameras(written) == views_of(written)
    assert find_cameras(with_views(clip, [])) == find_cameras(replace(clip, folder=None)) == ()
    some = clip.take(np.array([2]))
    for one, view in zip(views_of(written), find_cameras(some), strict=True):
        assert not view.masks.known.any()
        np.testing.assert_allclose(one.T_cam_view[2:], view.T_cam_view)
        for of in (view, one.take(np.array([2]))):
            masks = masks_in_view(clip_in_view(some, of), of)
            assert masks is not None
            np.testing.assert_array_equal(one.masks.object[2:], masks.object)


def test_a_view_without_any_of_the_frames_shows_nothing(stored: tuple[Clip, Clip]) -> None:
    clip = stored[1]
    path = clip.origin / "views" / "view2" / "view.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"frames": ["x", "y", "z"]}))
    assert [view.name for view in find_cameras(clip)] == ["view2", "view3"]
    views = read_views(clip)
    assert views is not None
    assert [view.masks.known.any() for view in views.each] == [False, True]


def test_masks_of_frames_that_a_view_lacks_are_not_its(stored: tuple[Clip, Clip]) -> None:
    """Its folder may have their files."""
    clip = stored[1]
    path = clip.origin / "views" / "view2" / "view.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"frames": clip.frames[1:]}))
    views, camera = read_views(clip), find_cameras(clip)[0]
    assert views is not None
    for masks in (views.each[0].masks, masks_in_view(clip_in_view(clip, camera), camera)):
        assert masks is not None
        assert masks.known.tolist() == [False, True, True]


def test_folders_of_views_are_folders_inside(stored: tuple[Clip, Clip], tmp_path: Path) -> None:
    clip = stored[1]
    views = clip.origin / "views"
    views.rename(tmp_path / "away")
    os.symlink(tmp_path / "away", views)
    with pytest.raises(InputError, match="leads out"):
        find_cameras(clip)
    views.unlink()
    views.write_text("")
    with pytest.raises(InputError, match="a folder of views"):
        find_cameras(clip)
