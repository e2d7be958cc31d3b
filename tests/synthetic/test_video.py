"""Rendered video: it shows the clip's object where the truth has it, with a shadow, the same for the same seed."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import av
import numpy as np
import pytest
from numpy import ndarray

from getagrip.cli import main
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.rasterize import render_coverage
from getagrip.synthetic.scene import Scene, ground_truth_masks, make_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.synthetic.video import VideoLook, _Bodies, _Lamp, render_video

pytestmark = pytest.mark.slow
SIZE = 320, 240


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("mug", 2, SceneOptions(frames=4, size=SIZE, focal=300.0))


@pytest.fixture(scope="module")
def pictures(scene: Scene) -> list[ndarray]:
    return list(render_video(scene, SIZE, seed=2))


def test_there_is_a_picture_of_each_frame_and_a_seed_makes_them(scene: Scene, pictures: list[ndarray]) -> None:
    assert [(picture.shape, picture.dtype) for picture in pictures] == [((*SIZE[::-1], 3), np.uint8)] * 4
    (again,) = islice(render_video(scene, SIZE, seed=2), 1)
    (other,) = islice(render_video(scene, SIZE, seed=5), 1)
    assert (again == pictures[0]).all()
    assert np.abs(other.astype(int) - pictures[0]).mean() > 5.0


def test_the_object_is_where_the_truth_has_it(scene: Scene, pictures: list[ndarray]) -> None:
    """Its colours, of its paint and its label, are in the true mask; the table's are where no body is."""
    look, masks = VideoLook.draw(2), ground_truth_masks(scene)
    bodies = _Bodies.of(scene, look)
    for n, picture in enumerate(pictures):
        chroma = picture / np.maximum(picture.sum(axis=-1, keepdims=True), 1.0)
        paints = np.stack([tone / tone.sum() for tone in (look.paint, look.label)])
        near_paint = np.linalg.norm(chroma[:, :, None] - paints, axis=-1).min(axis=-1)
        near_table = np.linalg.norm(chroma - look.table / look.table.sum(), axis=-1)
        painted, mask = near_paint < near_table, masks.object[n]
        assert painted[mask].mean() > 0.65  # stripes and the handle's shade are neither
        free = ~render_coverage(bodies.vertices(float(n)), bodies.faces, scene.clip.K[n], SIZE)
        assert painted[free].mean() < 0.15


def test_the_table_is_the_support_where_the_clip_states_one(scene: Scene) -> None:
    """So that an object that lies on it touches its shadow; else nothing reaches down to it."""
    world = scene.clip.world
    assert world is not None
    free = _Bodies.of(scene, VideoLook.draw(2))
    assert free.table_height < se3.transform(world.T_world_cam[0], free.vertices(0.0))[:, 2].min()
    supported = replace(scene, clip=replace(scene.clip, world=replace(world, support=0.125)))
    assert _Bodies.of(supported, VideoLook.draw(2)).table_height == 0.125


def test_bodies_shade_the_table_below_them_and_nothing_else(scene: Scene) -> None:
    bodies = _Bodies.of(scene, VideoLook.draw(2))
    lamp = _Lamp.over(bodies, 0, VideoLook.draw(2))
    T = bodies.T_world_cam(0)
    middle = T[:3, :3] @ bodies.vertices(0.0)[: len(scene.clip.hand.vertices[0])].mean(axis=0) + T[:3, 3]
    below = middle - lamp.direction * (middle[2] - bodies.table_height) / lamp.direction[2]
    assert lamp.lit(below[None])[0] < 0.2
    assert lamp.lit(below[None] + [2.0, 0.0, 0.0])[0] == 1.0
    assert lamp.lit((middle + 0.6 * lamp.direction)[None])[0] == 1.0


def test_the_camera_sees_the_world_as_the_clip_has_it(scene: Scene) -> None:
    """Between two frames, bodies are between where they are in these."""
    bodies = _Bodies.of(scene, VideoLook.draw(2))
    first, second = bodies.vertices(1.0), bodies.vertices(2.0)
    np.testing.assert_allclose(bodies.vertices(1.25), 0.75 * first + 0.25 * second, atol=1e-12)
    assert scene.clip.truth is not None
    T = scene.clip.truth.T_cam_obj[1]
    np.testing.assert_allclose(first[bodies.n_skin :], scene.object.vertices @ T[:3, :3].T + T[:3, 3], atol=1e-12)


def test_the_command_writes_clip_video_and_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getagrip.synthetic.video.VIDEO_SIZE_PX", (160, 120))
    words = ["synthesise", "bottle", "--seed", "5", "--frames", "3", "--out", str(tmp_path)]
    assert main([*words, "--video"]) == 0
    printed = capsys.readouterr().out
    (clip,) = (folder for folder in tmp_path.iterdir() if not folder.name.endswith("-video"))
    with av.open(str(clip) + "-video/video.mp4") as film:
        assert len(list(film.decode(video=0))) == 3
    read_mesh(Path(f"{clip}-video/mesh.obj"))
    assert f"getagrip draft {clip}-video/video.mp4 --object {clip}-video/mesh.obj --size-mm" in printed
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert main([*words[:1], "spaceship", *words[2:]]) == 2
    assert "choose from bottle" in capsys.readouterr().err
