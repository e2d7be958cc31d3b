"""Wrong arguments of the public functions and dataclasses are errors that say what is expected and how to get it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import getagrip
from getagrip.errors import UsageError
from getagrip.result import Reconstruction
from helpers.clips import small_clip

CLIP, MASKS = small_clip()
RESULT = Reconstruction.external("a", "x", CLIP.frames, np.tile(np.eye(4), (len(CLIP), 1, 1)))
BOX = trimesh.creation.box()
NAN = np.where(np.arange(len(CLIP))[:, None, None] == 1, np.nan, CLIP.hand.vertices)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: getagrip.reconstruct("clips/mug"), "clip of reconstruct must be a Clip (got 'clips/mug'); getagrip.r"),
        (lambda: getagrip.reconstruct(MASKS, CLIP), "(got a value of type Masks); the order is clip, masks, options"),
        (lambda: getagrip.reconstruct(CLIP, MASKS, 20), "must be Options, such as getagrip.Options(seed=1) (got a val"),
        (lambda: getagrip.write_clip("out", CLIP, MASKS), "(got 'out'); the order is clip, masks, folder"),
        (lambda: getagrip.write_clip(CLIP, "out", MASKS), "masks of write_clip must be Masks (got 'out'); the order"),
        (lambda: getagrip.write_mesh("a.obj", CLIP.mesh), "(got 'a.obj'); the order is mesh, path"),
        (lambda: getagrip.write_mesh(BOX, "a.obj"), "getagrip.Mesh(mesh.vertices, mesh.faces) makes one of a trimesh"),
        (lambda: replace(CLIP, mesh=BOX), "Clip.mesh must be a Mesh (got a value of type Trimesh); getagrip.read_mesh"),
        (lambda: getagrip.read_clip(3), "folder of read_clip must be a path: a text or a pathlib.Path (got a value"),
        (lambda: getagrip.evaluate(CLIP, RESULT), "result of evaluate must be a Reconstruction (got a value of type"),
        (lambda: getagrip.synthesise(3), "category of synthesise must be a text (got a value of type int)"),
        (lambda: RESULT.plot("report.png"), "clip of plot must be a Clip (got 'report.png')"),
        (lambda: RESULT.show(masks=CLIP), "masks of show must be Masks (got a value of type Clip)"),
        (lambda: RESULT.plot(maks=MASKS), "unknown argument of plot 'maks'; choose from masks"),
        (
            lambda: getagrip.HandTrack(CLIP.hand.vertices, CLIP.hand.faces, CLIP.hand.T_cam_hand),
            "missing thumb, index, middle, ring, pinky in HandTrack.regions: vertex ids of the pad of each fingertip; ",
        ),
        (lambda: replace(CLIP.hand, vertices=NAN), "HandTrack.vertices must be finite numbers (got "),
        (lambda: replace(CLIP.hand, T_cam_hand=np.full((len(CLIP), 4, 4), np.inf)), "HandTrack.T_cam_hand must be fin"),
        (lambda: replace(CLIP, K=np.full((len(CLIP), 3, 3), np.nan)), "Clip.K must be finite numbers (got "),
        (
            lambda: replace(CLIP, times=np.array([0.0, np.nan, 0.1])),
            "Clip.times must be finite numbers (got 1 NaN or in",
        ),
        (lambda: getagrip.Mesh(np.full((3, 3), np.nan), CLIP.mesh.faces[:0]), "Mesh.vertices must be finite numbers"),
    ],
)
def test_wrong_arguments_are_named_with_the_right_ones(call: Callable[[], object], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        call()
    assert said in str(caught.value)


def test_masks_without_occluders_need_say_nothing_of_them() -> None:
    assert not getagrip.Masks(object=MASKS.object).ignore.any()
    assert getagrip.Masks(object=MASKS.object).ignore.shape == MASKS.object.shape
