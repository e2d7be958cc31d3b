"""Drafts of several cameras: each sees the hand and the object, and the hand gets its size and place from them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.cli import calls
from getagrip.cli.draft_views import DraftedView, DraftedViews
from getagrip.clip import HandTrack, read_clip, write_clip
from getagrip.clip.views import read_views
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.from_2d.clicks import ASSUMED_SCALE_NOTE
from getagrip.hands.model import hand_track
from getagrip.io import files
from getagrip.provenance import Source, assumed, measured
from getagrip.studio.hands.detect_hands import DetectedHands
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.labelled_scene import HEIGHT, RADIUS, WIDTH, K, SceneNets, middle, write_scene

N_FRAMES = 3
SIZE = (320, 240)
T_SIDE = se3.rigid(se3.exp_so3(np.array([0.0, -1.2, 0.0])), np.array([0.55, 0.0, 0.4]))


class Blank:
    """Footage of black images, named as the clip's frames."""

    frames, fps, size = N_FRAMES, 30.0, SIZE

    def name(self, n: int) -> str:
        return f"{n:04d}"

    def image(self, n: int) -> np.ndarray:
        return np.zeros((SIZE[1], SIZE[0], 3), np.uint8)


def true_hand() -> HandTrack:
    hand = generic.load("right").with_shape().with_pose(np.tile(0.2 * np.sin(np.arange(45)), (N_FRAMES, 1)))
    n = np.arange(N_FRAMES)[:, None]
    return hand_track(hand, se3.rigid(se3.exp_so3(0.1 * n + [0.4, 0.2, 0.0]), 0.01 * n + [0.0, 0.0, 0.6]))


def joints_of(hand: HandTrack) -> np.ndarray:
    assert hand.joints is not None
    return se3.transform(hand.T_cam_hand, hand.joints)


def lifted_clip(folder: Path) -> Path:
    """A clip whose hand is 0.85 times as large as the true one, and nearer, as one view sees it."""
    true = true_hand()
    T = true.T_cam_hand.copy()
    T[:, :3, 3] *= 0.85
    seen, sure = project(K, joints_of(true)), np.ones((N_FRAMES, 21))
    assert true.joints is not None
    smaller = {"vertices": 0.85 * true.vertices, "joints": 0.85 * true.joints}
    hand = replace(true, **smaller, T_cam_hand=T, joints_2d=seen, joints_2d_confidence=sure)
    clip, _ = small_clip(N_FRAMES)
    sources = {"hands_scale": assumed(ASSUMED_SCALE_NOTE), "camera": "measured"}
    clip = replace(clip, hand=hand, truth=None, K=np.tile(K, (N_FRAMES, 1, 1)), size=SIZE, provenance=sources)
    return write_clip(clip, None, folder)


def side_view(off: float = 0.0) -> DraftedView:
    """A view from the side, whose joints are off by some pixels."""
    true = true_hand()
    points = project(K, se3.transform(se3.inverse(T_SIDE), joints_of(true))) + off
    seen = replace(true, joints_2d=points, joints_2d_confidence=np.ones((N_FRAMES, 21)))
    found = DetectedHands(seen, "right", (0, 1, 2), {}, K, {"hands": Source("a test's")})
    at = {f"{n:04d}": n for n in range(N_FRAMES)}
    return DraftedView("side", Blank(), at, K, T_SIDE, measured("a test"), 0.0, found, None)  # type: ignore[arg-type]


def test_a_lifted_hand_gets_its_size_and_place_from_a_second_view(tmp_path: Path) -> None:
    folder = lifted_clip(tmp_path / "clip")
    off = np.linalg.norm(joints_of(read_clip(folder).hand) - joints_of(true_hand()), axis=-1)
    assert off.min() > 0.05
    said = DraftedViews((side_view(),)).add_to(folder)
    assert "joints triangulated from 2 views in 3 of 3 frames: the hand is 1.18 times as large" in said
    clip = read_clip(folder)
    np.testing.assert_allclose(joints_of(clip.hand), joints_of(true_hand()), atol=1e-6)
    scale = clip.provenance["hands_scale"]
    assert isinstance(scale, Source)
    assert scale.basis == "estimated"
    views = read_views(clip)
    assert views is not None
    assert views.each[0].joints_2d_confidence is not None
    assert views.each[0].joints_2d_confidence.all()
    assert (folder / "views" / "side" / "frames" / "0002.jpg").is_file()


def test_a_calibration_of_other_cameras_leaves_the_hand_as_it_is(tmp_path: Path) -> None:
    folder = lifted_clip(tmp_path / "clip")
    before = read_clip(folder).hand.T_cam_hand
    turned = replace(side_view(), T_cam_view=T_SIDE @ se3.rigid(se3.exp_so3(np.array([0.5, 0.3, 0.0])), None))
    assert "do not meet; is the calibration theirs?" in DraftedViews((turned,)).add_to(folder)
    np.testing.assert_array_equal(read_clip(folder).hand.T_cam_hand, before)
    assert "no other view shows its joints" in DraftedViews((replace(side_view(), hand=None),)).add_to(folder)


def test_a_view_of_other_frames_is_left_out(tmp_path: Path) -> None:
    folder = lifted_clip(tmp_path / "clip")
    assert "view side: images of 1 frame" in DraftedViews((replace(side_view(), at={"0001": 1}),)).add_to(folder)
    assert not (folder / "views").exists()


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets())
    monkeypatch.setattr(
        "getagrip.studio.hands.detect_hands.hand_mask", lambda *_, **__: np.zeros((HEIGHT, WIDTH), bool)
    )
    write_scene(tmp_path / "scene.mp4", 6)
    write_scene(tmp_path / "right.mp4", 6)
    of = {"K": K.tolist(), "size": [WIDTH, HEIGHT]}
    right = {**of, "T_world_cam": se3.rigid(None, np.array([0.3, 0.0, 0.0])).tolist()}
    bent = {"distortion": [1e-4, 0.0, 0.0, 0.0]}
    files.write_json(tmp_path / "rig.json", {"left": {**of, "T_world_cam": np.eye(4)}, "right": {**right, **bent}})
    return tmp_path


DRAFT = ("draft", "scene.mp4", "--object", "cup", "--out", "out", "--no-page")
VIEWS = ("--view", "right=right.mp4", "--cameras", "rig.json")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--view", "right=right.mp4"), "missing --cameras"),
        ((*VIEWS, "--K", "1", "1", "1", "1"), "--K cannot be used with --cameras"),
        ((*VIEWS, "--box-view", "left=1,1,9,9"), "--box-view must be of a --view (got left)"),
        ((*VIEWS, "--camera", "right"), "another camera than the views'"),
    ],
)
def test_options_that_do_not_fit_are_named(scene: Path, run: Run, words: tuple[str, ...], says: str) -> None:
    status, _, err = run(*DRAFT, *words)
    assert (status, says in err) == (2, True), err
    assert not (scene / "out" / "found").exists()


@pytest.mark.slow
def test_hands_and_masks_of_each_video_are_in_the_clip(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = (middle(0) - RADIUS - 3.0).tolist()
    box = f"{x},{y},{2 * RADIUS + 6},{2 * RADIUS + 6}"
    made = list[str]()
    real = calls.run_call

    def without_fit(call: calls.CommandCall) -> str:
        made.append(call.words[0])
        return real(call) if call.words[0] == "clip" else ""

    monkeypatch.setattr(calls, "run_call", without_fit)
    run(*DRAFT, *VIEWS, "--object-box", box, "--box-view", f"right={box}", "--size-mm", "90")
    assert made[0] == "clip"
    (folder,) = (scene / "out" / "clips").iterdir()
    about = json.loads((folder / "views" / "right" / "view.json").read_text())
    assert about["camera"]["T_cam_view"][0][3] == 0.3
    assert "lens distortion removed" in str(about["provenance"]["camera"])
    assert len([*(scene / "out" / "views" / "right" / "undistorted" / "right").iterdir()]) == 6
    clip = read_clip(folder)
    np.testing.assert_allclose(clip.K[0], K)
    views = read_views(clip)
    assert views is not None
    (view,) = views.each
    for n, name in enumerate(clip.frames):
        u, v = middle(int(name) - 1).astype(int)
        assert np.asarray(view.masks.object[n])[v, u]
    assert view.joints_2d is not None
