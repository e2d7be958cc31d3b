"""Laws of hands that jump: they are found and put between their neighbours, and real motion is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip
from getagrip.fitting.hand.refine_hand import frames_without_glitch, repair_hand
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from helpers.scenes import SHORT, scene

FRAMES = 40


def along(motion: ndarray) -> Clip:
    """A hand that moves by ``motion`` (T, 6): shift [m] and turn [rad] in the camera's frame."""
    clip, _ = scene("can", 0, SHORT)
    one = clip.take(np.zeros(len(motion), int))
    T = se3.rigid(se3.exp_so3(motion[:, 3:]), motion[:, :3]) @ one.hand.T_cam_hand
    names = tuple(f"{n:06d}" for n in range(len(motion)))
    return replace(one, frames=names, hand=replace(one.hand, T_cam_hand=T), truth=None)


def smooth() -> Clip:
    """A hand that turns about the camera and goes 20 cm aside, and back, in 40 frames."""
    t = np.linspace(0.0, np.pi, FRAMES)[:, None]
    return along(np.sin(t) * [0.2, 0.05, 0.05, 0.2, 0.3, 0.1])


def flipped(clip: Clip, frames: list[int], angle: float = np.pi) -> Clip:
    """Turn the hand about one of its axes after the other, by half a turn unless ``angle`` [rad] says otherwise."""
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(angle * np.eye(3)[np.arange(1, len(frames) + 1) % 3])
    T[frames] = T[frames] @ se3.rigid(R, middle - R @ middle)
    return clip.with_hand_at(T)


def glitches_of(clip: Clip) -> tuple[str, ...]:
    glitches = repair_hand(clip, Options())[1]
    assert glitches is not None
    return glitches.frames


def test_a_hand_that_moves_is_left_as_it_is() -> None:
    clip = smooth()
    assert repair_hand(clip, Options()) == (clip, Glitches((), FRAMES))


def test_a_hand_that_is_shaken_is_left_as_it_is() -> None:
    """By 10 cm, 3 times a second, at 30 frames a second."""
    t = np.arange(FRAMES)[:, None] / 30.0
    clip = along(0.05 * np.sin(2.0 * np.pi * 3.0 * t) * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert glitches_of(clip) == ()


def test_a_hand_that_goes_elsewhere_and_stays_does_not_jump() -> None:
    clip = along(np.where(np.arange(FRAMES)[:, None] < 20, 0.0, 0.3) * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert glitches_of(clip) == ()


def test_a_hand_that_comes_in_fast_and_slows_down_keeps_its_frames() -> None:
    """Steps as of a hand that reaches for an object in DexYCB [mm]."""
    steps = [69, 115, 63, 61, 52, 52, 29, 28, 12, 12, 4, 5, 2, 5, 3, 1, 2, 2, 4, 4, 4, 4, 5, 7, 8, 16, 7, 5, 6, 7]
    way = 1e-3 * np.cumsum([0, *steps])[:, None] * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for motion in (way, way[::-1]):
        assert glitches_of(along(motion)) == ()


@pytest.mark.parametrize("frames", [[7], [7, 20], [10, 11, 12], [0], [39], [3, 9, 15, 16, 22, 30, 36]])
def test_jumps_are_found_and_put_right(frames: list[int]) -> None:
    clip = smooth()
    steady, glitches = repair_hand(flipped(clip, frames, angle=2.0), Options())
    assert glitches is not None
    assert glitches.frames == tuple(clip.frames[n] for n in frames)
    assert steady.hand.vertices is clip.hand.vertices
    kept = np.setdiff1d(np.arange(FRAMES), frames)
    assert np.array_equal(steady.hand.T_cam_hand[kept], clip.hand.T_cam_hand[kept])
    off = se3.transform(steady.hand.T_cam_hand, clip.hand.vertices) - se3.transform(
        clip.hand.T_cam_hand, clip.hand.vertices
    )
    assert np.abs(off).max() < (0.005 if {0, 39}.isdisjoint(frames) else 0.03)


@pytest.mark.parametrize("frames", [[0], [39], [7, 20], [10, 11, 12], [n for n in range(FRAMES) if n % 5 > 1]])
def test_flips_are_undone(frames: list[int]) -> None:
    """In three frames of five, too: each axis has fewer of them than there are hands as they should be."""
    clip = smooth()
    steady, glitches = repair_hand(flipped(clip, frames), Options())
    assert glitches == Glitches(tuple(clip.frames[n] for n in frames), FRAMES)
    assert np.allclose(steady.hand.T_cam_hand, clip.hand.T_cam_hand, atol=1e-12)


def test_jumps_are_the_same_from_any_camera_and_in_reverse() -> None:
    clip = flipped(flipped(smooth(), [5, 17, 18]), [8, 30], angle=2.0)
    kept = np.array(frames_without_glitch(clip.hand))
    rng = np.random.default_rng(0)
    elsewhere = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)) @ clip.hand.T_cam_hand
    assert np.array_equal(frames_without_glitch(replace(clip.hand, T_cam_hand=elsewhere)), kept)
    reverse = np.arange(FRAMES)[::-1]
    frames, flip = frames_without_glitch(clip.hand.take(reverse))
    assert np.array_equal([reverse[frames][::-1], flip[::-1]], kept)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames_have_no_jumps_that_could_be_told(frames: int) -> None:
    clip = smooth().take(np.arange(frames))
    assert glitches_of(clip) == ()


def test_hands_are_believed_where_asked_to_and_by_the_method_to_the_letter() -> None:
    clip = flipped(smooth(), [5])
    for options in (Options(hands="as-given"), Options(method="paper")):
        assert repair_hand(clip, options) == (clip, None)


def test_a_result_says_where_the_hand_jumps_and_has_it_put_right() -> None:
    clip, masks = scene("can", 0)
    bad = flipped(clip, [3])
    options = Options(inits=6, every_frame=False)
    result, right = (reconstruct(one, masks, options) for one in (bad, clip))
    assert result.T_cam_hand is not None
    middle = clip.hand.vertices.mean(axis=(0, 1))[None]
    off = se3.transform(result.T_cam_hand, middle) - se3.transform(clip.hand.T_cam_hand, middle)
    assert np.linalg.norm(off, axis=-1).max() < 0.02
    assert {"tracker-glitches"} == {f.check for f in result.findings} - {f.check for f in right.findings}
    assert clip.frames[3] in next(f for f in result.findings if f.check == "tracker-glitches").message
