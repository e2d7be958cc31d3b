"""Views of a clip: written and read, checked, and taken apart by frames."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, input_sha256, read_clip, with_evidence, write_clip
from getagrip.clip.depth import Depth, DepthSource
from getagrip.clip.views import MAX_VIEWS, View, Views, clip_in_view, views_of, with_views
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from helpers.clips import small_clip

SIDE = se3.rigid(se3.exp_so3(np.array([0.0, -1.2, 0.0])), np.array([0.5, 0.0, 0.3]))


def a_view(clip: Clip, masks: Masks, name: str = "side", **more: object) -> View:
    T = np.tile(SIDE, (len(clip), 1, 1))
    return replace(View(name=name, size=clip.size, K=clip.K, T_cam_view=T, masks=masks), **more)  # type: ignore[arg-type]


def stored(folder: Path, **more: object) -> Path:
    clip, masks = small_clip()
    return write_clip(with_views(clip, [a_view(clip, masks, **more)]), masks, folder)


def test_views_survive_a_round_trip(tmp_path: Path) -> None:
    clip, masks = small_clip()
    rng = np.random.default_rng(0)
    moving = np.tile(SIDE, (3, 1, 1)) @ se3.rigid(se3.exp_so3(0.1 * rng.standard_normal((3, 3))), np.zeros(3))
    hand = replace(masks, hand=np.roll(masks.object, 3, axis=1) & ~masks.object)
    joints = {"joints_2d": rng.uniform(0.0, 20.0, (3, 21, 2)), "joints_2d_confidence": rng.uniform(size=(3, 21))}
    views = [
        a_view(clip, hand, T_cam_view=moving, time_offset=0.01, provenance={"camera": "a calibration"}, **joints),
        a_view(clip, masks, "top", K=clip.K * np.linspace(1.0, 1.1, 3)[:, None, None] ** [[1], [1], [0]]),
    ]
    write_clip(with_views(clip, views), masks, tmp_path / "clip")
    found = views_of(with_evidence(read_clip(tmp_path / "clip")))
    assert [view.name for view in found] == ["side", "top"]
    for view, wanted in zip(found, views, strict=True):
        np.testing.assert_array_equal(view.masks.object, wanted.masks.object)
        np.testing.assert_array_equal(view.masks.ignore, wanted.masks.ignore)
        for key in ("K", "T_cam_view"):
            np.testing.assert_allclose(getattr(view, key), getattr(wanted, key))
    np.testing.assert_array_equal(found[0].masks.hand, hand.hand)  # type: ignore[arg-type]
    np.testing.assert_allclose(found[0].joints_2d, joints["joints_2d"])  # type: ignore[arg-type]
    assert found[0].time_offset == 0.01
    assert found[0].provenance["camera"] is not None
    assert found[1].joints_2d is None


def test_a_views_depth_survives_too(tmp_path: Path) -> None:
    clip, masks = small_clip()
    z = np.full((3, 8, 8), 0.7)
    depth = Depth(z, np.zeros((3, 2), int), np.full(3, 2), clip.size, DepthSource("metric", "sensor", 0.001))
    write_clip(with_views(clip, [a_view(clip, masks, depth=depth)]), masks, tmp_path / "clip")
    (found,) = views_of(with_evidence(read_clip(tmp_path / "clip")))
    assert found.depth is not None
    assert found.depth.source == depth.source
    np.testing.assert_allclose(np.median(found.depth.z[found.depth.z > 0.0]), 0.7, atol=1e-3)


def test_a_clip_in_its_view_is_the_same_scene() -> None:
    clip, masks = small_clip()
    view = a_view(clip, masks)
    seen = clip_in_view(clip, view)
    assert clip.truth is not None
    assert seen.truth is not None
    pairs = (clip.hand.T_cam_hand, seen.hand.T_cam_hand), (clip.truth.T_cam_obj, seen.truth.T_cam_obj)
    for mine, theirs in pairs:
        np.testing.assert_allclose(view.T_cam_view @ theirs, mine, atol=1e-12)
    assert views_of(seen) == ()


def test_a_view_may_lack_frames_and_masks(tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip")
    side = folder / "views" / "side"
    fields = json.loads((side / "view.json").read_text())
    (side / "view.json").write_text(json.dumps(fields | {"frames": ["0002", "0001"]}))
    (side / "masks" / "object" / "0001.png").unlink()
    (side / "masks" / "object" / "0000.png").unlink()
    (view,) = views_of(with_evidence(read_clip(folder)))
    assert view.masks.known.tolist() == [False, False, True]
    shutil.rmtree(side / "masks")
    (view,) = views_of(with_evidence(read_clip(folder)))
    assert not view.masks.known.any()


def test_files_of_views_count_in_the_checksum(tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip")
    before = input_sha256(folder)
    path = folder / "views" / "side" / "view.json"
    path.write_text(path.read_text().replace("0.3", "0.31"))
    assert input_sha256(folder) != before


def described(**changes: object) -> Callable[[Path], None]:
    def apply(side: Path) -> None:
        fields = json.loads((side / "view.json").read_text())
        camera = {**fields["camera"], **changes.pop("camera", {})}  # type: ignore[dict-item]
        (side / "view.json").write_text(json.dumps({**fields, "camera": camera, **changes}))

    return apply


def far_away(side: Path) -> None:
    T = np.array([SIDE, SIDE, SIDE])
    T[1, :3, 3] *= 1e4
    described(camera={"T_cam_view": T.tolist()})(side)


def linked_out(side: Path) -> None:
    outside = side.parents[2] / "outside"
    shutil.move(side, outside)
    side.symlink_to(outside)


WRONG: dict[str, tuple[Callable[[Path], None], str]] = {
    "an unknown key": (described(fps=30), "fps must be one of version"),
    "another version": (described(version=2), "version must be 1"),
    "no pose": (described(camera={"T_world_cam": np.eye(4).tolist()}), "camera must be"),
    "a pose that is not rigid": (described(camera={"T_cam_view": (2.0 * np.eye(4)).tolist()}), "camera.T_cam_view"),
    "poses of other frames": (described(camera={"T_cam_view": [np.eye(4).tolist()] * 2}), "camera.T_cam_view"),
    "a camera in millimetres": (far_away, "millimetres"),
    "a focal length of nothing": (described(camera={"K": np.eye(3).tolist()}), "camera.K"),
    "a view of the next minute": (described(time_offset=60.0), "time_offset must be"),
    "frames twice": (described(frames=["0000", "0000", "0001"]), "frames"),
    "no description": (lambda side: (side / "view.json").unlink(), "view.json"),
    "a damaged mask": (lambda side: (side / "masks" / "object" / "0000.png").write_bytes(b"none"), "0000.png"),
    "a link that leads out": (linked_out, "side"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_view_is_an_error_that_names_it(fault: str, tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip")
    breaks, message = WRONG[fault]
    breaks(folder / "views" / "side")
    with pytest.raises(InputError, match=message):
        with_evidence(read_clip(folder))


def test_views_are_not_without_number(tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip")
    for n in range(MAX_VIEWS):
        (folder / "views" / f"v{n}").mkdir()
    with pytest.raises(InputError, match=f"at most {MAX_VIEWS}"):
        with_evidence(read_clip(folder))


def test_views_in_memory_are_checked() -> None:
    clip, masks = small_clip()
    view = a_view(clip, masks)
    with pytest.raises(UsageError, match="different names"):
        Views((view, view))
    with pytest.raises(UsageError, match=r"View\.name"):
        replace(view, name="../side")
    with pytest.raises(UsageError, match=r"View\.masks"):
        replace(view, size=(64, 48))
    with pytest.raises(UsageError, match="go together"):
        replace(view, joints_2d=np.zeros((3, 21, 2)))


def test_a_cut_clip_keeps_its_views() -> None:
    clip, masks = small_clip()
    cut = with_views(clip, [a_view(clip, masks)]).take(np.array([2, 0]))
    (view,) = views_of(cut)
    np.testing.assert_array_equal(view.masks.object, masks.object[[2, 0]])
    uv = project(view.K, se3.transform(view.T_view_cam @ cut.hand.T_cam_hand, cut.hand.vertices))
    seen = clip_in_view(clip, a_view(clip, masks))
    np.testing.assert_allclose(uv, project(seen.K, se3.transform(seen.hand.T_cam_hand, seen.hand.vertices))[[2, 0]])
