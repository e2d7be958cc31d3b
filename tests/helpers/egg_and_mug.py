"""A mug that turns in a hand, which is an egg: the clip, and its perfect result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.clip import FINGERS, Clip, HandTrack, Masks, Truth, input_sha256, write_clip
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_coverage
from getagrip.result import Candidates, Reconstruction, Status, write_result
from getagrip.synthetic import objects

FRAMES = 5


def egg_and_mug() -> tuple[Clip, Masks]:
    """A mug that turns in a hand, which is an egg."""
    rng = np.random.default_rng(0)
    egg = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    vertices = np.tile(np.asarray(egg.vertices) * [1.5, 1.0, 0.7], (FRAMES, 1, 1))
    steps = se3.exp_so3(rng.normal(scale=0.2, size=(FRAMES, 3)))
    T_cam_hand = se3.rigid(steps, rng.normal([0.0, 0.0, 0.5], 0.02, (FRAMES, 3)))
    line = se3.rotation_about_line(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 0.4, FRAMES))
    T_hand_obj = line @ se3.rigid(t=np.array([0.0, 0.07, -0.05]))
    clip = Clip(
        name="egg-and-mug",
        category="mug",
        side="right",
        fps=30.0,
        frames=tuple(f"{n:06d}" for n in range(FRAMES)),
        size=(320, 240),
        K=np.tile([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]], (FRAMES, 1, 1)),
        mesh=objects.mug(),
        scale="known",
        hand=HandTrack(vertices, np.asarray(egg.faces), T_cam_hand, {f: np.array([n]) for n, f in enumerate(FINGERS)}),
        truth=Truth(T_cam_hand @ T_hand_obj, 1.0, T_cam_hand, vertices),
    )
    assert clip.truth is not None
    posed = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices)
    drawn = [
        render_coverage(vertices, clip.mesh.faces, K, clip.size) for vertices, K in zip(posed, clip.K, strict=True)
    ]
    return clip, Masks(np.stack(drawn), np.zeros((FRAMES, 240, 320), dtype=bool))


def perfect(clip: Clip, name: str = "egg-and-mug") -> Reconstruction:
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return Reconstruction(
        clip=name,
        method="static",
        frames=clip.frames,
        T_hand_obj=T,
        scale=clip.truth.scale,
        iou=np.ones(len(clip)),
        axis=None,
        candidates=Candidates(T[None], np.array([clip.truth.scale]), np.zeros(1)),
        energy={"total": 0.0},
        status=Status.FINISHED,
        ambiguous=False,
        seconds={"total": 0.0},
    )


def written(scene: tuple[Clip, Masks], folder: Path) -> tuple[Path, Path]:
    """The clip and a perfect result of it, in folders."""
    clip = write_clip(*scene, folder / "clips" / scene[0].name)
    result = perfect(scene[0])
    return clip, write_result(result, folder / "results" / scene[0].name, input_sha256(clip), clip_folder=clip)


def same(a: dict[str, float], b: dict[str, float], tolerance: float = 1e-6) -> None:
    assert a.keys() == b.keys()
    for key, value in a.items():
        assert value == pytest.approx(b[key], abs=tolerance, nan_ok=True), key
