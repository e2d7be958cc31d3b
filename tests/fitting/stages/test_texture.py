"""Texture tells front from back: a pose turned by half is turned back, in any light; plain colours change nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import getagrip
from getagrip.clip import Clip, Masks
from getagrip.fitting.evidence.texture import TEXTURE_KEY
from getagrip.fitting.hand.hand_error_model import SolvedHand
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.stages.texture import prefer_texture
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, subdivide_surface
from getagrip.geometry.rasterize import depth_and_face, interpolate_vertex_values


def textured_clip(seed: int, kind: str = "box") -> tuple[Clip, Masks]:
    clip, masks = getagrip.synthesise(kind, seed=seed)
    vertices, faces = subdivide_surface(clip.mesh.vertices, clip.mesh.faces, clip.mesh.diameter / 40)
    rng = np.random.default_rng(seed)
    waves = np.sin(vertices @ rng.normal(0.0, 25.0 / clip.mesh.diameter, (3, 3)) + rng.uniform(0.0, 6.0, 3))
    return replace(clip, mesh=Mesh(vertices, faces, (128 + 100 * waves).astype(np.uint8))), masks


def fitted(clip: Clip, masks: Masks, folder: Path, gain: float, off: int = 0) -> tuple[Problem, MethodResult]:
    """Fit a clip with images in a light, in which the object is ``off`` pixels from its masks."""
    assert clip.truth is not None
    assert clip.mesh.colours is not None
    images = []
    for T, K in zip(clip.truth.T_cam_obj, clip.K, strict=True):
        posed = se3.transform(T, clip.mesh.vertices)
        face = depth_and_face(posed, clip.mesh.faces, K, clip.size)[1]
        image = np.full((*face.shape, 3), 90.0)
        colours = clip.mesh.colours.astype(float)
        image[face >= 0] = interpolate_vertex_values(posed, clip.mesh.faces, K, face, colours)
        images.append(np.roll((gain * image).astype(np.uint8), off, axis=(0, 1)))
    folder = getagrip.write_clip(clip, masks, folder, images=images)
    problem = prepare_problem(getagrip.read_clip(folder), Options(inits=20))
    return problem, METHODS["soft-hinge"].fit(problem, lambda stage: None)


def turned(problem: Problem, found: MethodResult) -> MethodResult:
    assert found.motion is not None
    motion = found.motion.take(np.zeros(1, int)).rotated(se3.exp_so3(np.pi * problem.surface.axes[2:]))
    return replace(found, motion=motion, poses=motion.poses(), energy=found.energy[:1])


@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_a_box_turned_by_half_is_turned_back_in_any_light(tmp_path: Path, gain: float) -> None:
    problem, found = fitted(*textured_clip(0), tmp_path / "clip", gain)
    assert problem.clip.truth is not None
    true = problem.clip.truth.T_cam_obj[:, :3, :3]
    hand = SolvedHand(problem.clip.hand.T_cam_hand, np.eye(6), {}, np.nan)
    starts = found, turned(problem, replace(found, hand=hand))
    preferred = [prefer_texture(problem, start) for start in starts]
    for back in preferred:
        R = problem.clip.hand.T_cam_hand[:, :3, :3] @ back.poses.R[0]
        assert np.degrees(se3.angle_between(R, true)).max() < 20.0
        assert back.energy[0] == back.energy.min()
        assert back.texture.against == 0.0
    assert preferred[1].hand is hand
    assert max(back.texture.gain for back in preferred) > 10.0


def test_colours_that_are_off_by_some_pixels_turn_a_box_back(tmp_path: Path) -> None:
    """A pose that errs by ten degrees shifts its picture as much."""
    problem, found = fitted(*textured_clip(0), tmp_path / "clip", 1.0, off=13)
    assert problem.clip.truth is not None
    for start in (found, turned(problem, found)):
        R = problem.clip.hand.T_cam_hand[:, :3, :3] @ prefer_texture(problem, start).poses.R[0]
        assert np.degrees(se3.angle_between(R, problem.clip.truth.T_cam_obj[:, :3, :3])).max() < 20.0


def test_the_angle_of_a_can_about_its_axis_is_found(tmp_path: Path) -> None:
    problem, found = fitted(*textured_clip(0, "can"), tmp_path / "clip", 1.0)
    assert problem.clip.truth is not None
    back = prefer_texture(problem, found)
    R = problem.clip.hand.T_cam_hand[:, :3, :3] @ back.poses.R[0]
    assert np.degrees(se3.angle_between(R, problem.clip.truth.T_cam_obj[:, :3, :3])).mean() < 15.0


def test_plain_and_other_colours_change_nothing(tmp_path: Path) -> None:
    problem, found = fitted(*textured_clip(0), tmp_path / "clip", 1.0)
    mesh, wrong = problem.clip.mesh, turned(problem, found)
    assert mesh.colours is not None
    for colours in (np.full_like(mesh.colours, 120), np.random.default_rng(0).permutation(mesh.colours), None):
        other = replace(problem, clip=replace(problem.clip, mesh=replace(mesh, colours=colours)))
        same = prefer_texture(other, wrong)
        assert np.array_equal(same.poses.R, wrong.poses.R)
        assert not same.texture.gain > 0.0
        assert not same.texture.against > 0.0
    left_out = prefer_texture(replace(problem, options=replace(problem.options, without=(TEXTURE_KEY,))), wrong)
    assert np.array_equal(left_out.poses.R, wrong.poses.R)
    assert np.isnan(left_out.texture.correlation)
    for path in problem.clip.evidence[TEXTURE_KEY].paths:  # type: ignore[union-attr]
        path.write_bytes(b"no image")
    unread = prefer_texture(problem, wrong)
    assert np.array_equal(unread.poses.R, wrong.poses.R)
    assert unread.texture.unread > 1
