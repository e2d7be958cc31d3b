"""Clips and masks made of arrays, without a folder: what does not fit is refused as it is in files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from getagrip import Clip, Mesh, Reconstruction, UsageError, World, evaluate, reconstruct, synthesise, write_report
from getagrip.clip import check_clip, check_masks, find_masks
from getagrip.fitting.options import Options
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip

Refused = Callable[..., str]
CLIP, MASKS = small_clip()
WRONG: dict[str, tuple[Clip, str]] = {
    "are these millimetres?": (
        replace(CLIP, hand=replace(CLIP.hand, vertices=1e3 * CLIP.hand.vertices), truth=None),
        "small: vertices",
    ),
    "behind the camera": (
        replace(CLIP, hand=replace(CLIP.hand, T_cam_hand=np.diag([-1.0, 1.0, -1.0, 1.0]) @ CLIP.hand.T_cam_hand)),
        "T_cam_hand",
    ),
    "the focal length 4.1e+06": (replace(CLIP, K=CLIP.K * [[1e5, 1, 1], [1, 1e5, 1], [1, 1, 1]]), "camera.K"),
    "110 m large": (replace(CLIP, mesh=Mesh(1e3 * CLIP.mesh.vertices, CLIP.mesh.faces)), "mesh"),
    "points within the mesh": (replace(CLIP, handle=CLIP.mesh.centre[None] + 1.0), "handle"),
    "look inward": (replace(CLIP, mesh=Mesh(CLIP.mesh.vertices, CLIP.mesh.faces[:, ::-1])), "mesh"),
    "(got 1e-299)": (replace(CLIP, fps=1e-299), "fps must be frames per second"),
    "(got 1e+299)": (replace(CLIP, fps=1e299), "fps must be frames per second"),
    "are these seconds?": (replace(CLIP, times=1e-310 * np.arange(3)), "times"),
    "no rigid motion in frame '0000'": (
        replace(CLIP, world=World(1.1 * np.tile(np.eye(4), (3, 1, 1)))),
        "camera.T_world_cam",
    ),
    "a hand without vertices": (
        replace(CLIP, hand=replace(CLIP.hand, vertices=np.zeros((3, 0, 3)), faces=CLIP.hand.faces[:0], regions={})),
        "vertices",
    ),
}


def test_the_small_clip_is_a_clip() -> None:
    check_clip(CLIP)
    check_masks(CLIP, MASKS)


@pytest.mark.parametrize("words", WRONG)
def test_what_no_clip_can_be_is_refused(refused: Refused, words: str) -> None:
    clip, key = WRONG[words]
    refused(lambda: check_clip(clip), key, words)
    refused(lambda: reconstruct(clip, MASKS), key, words)


@pytest.mark.slow
def test_masks_of_another_clip_are_refused_everywhere() -> None:
    two = MASKS.take(np.array([0, 1]))
    result = reconstruct(CLIP, MASKS, Options(inits=1))
    for call in (
        lambda: reconstruct(CLIP, two),
        lambda: evaluate(result, CLIP, two),
        lambda: write_report(result, CLIP, two, "nowhere.png"),
        lambda: check_masks(replace(CLIP, size=(24, 32)), MASKS),
    ):
        with pytest.raises(UsageError, match=r"masks must be of the shape .*, as the clip small \(got "):
            call()


def test_a_clip_in_no_folder_has_no_masks_to_read(refused: Refused) -> None:
    assert find_masks(CLIP) is None
    refused(lambda: reconstruct(CLIP), "small: masks", "in no folder")


@pytest.mark.slow
def test_a_result_of_some_frames_is_evaluated_against_the_whole_clip() -> None:
    clip, masks = synthesise("mug", seed=3, options=SceneOptions(frames=9, size=(320, 240), focal=300.0))
    result = reconstruct(clip, masks, Options(inits=4, frames=4))
    index = clip.index_of(result.frames)
    assert clip.take(index).frames == result.frames
    whole = evaluate(result, clip, masks)
    assert whole == evaluate(result, clip.take(index), masks.take(index))
    assert whole.frames == list(result.frames)


@pytest.mark.slow
def test_a_frame_that_is_none_of_the_clips_is_named(refused: Refused) -> None:
    result = reconstruct(CLIP, MASKS, Options(inits=1))
    other: Reconstruction = replace(result, frames=("x0", *result.frames[1:]))
    for call in (lambda: evaluate(other, CLIP), lambda: write_report(other, CLIP, None, "nowhere.png")):
        refused(call, "small: frames", "the frame 'x0'", "0000 to 0002")
