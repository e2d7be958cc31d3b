"""Surface motion: a textured can that turns in a steady hand is followed, and nothing else is turned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

import getagrip
from getagrip.clip import Clip, Masks
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.fitting.stages.remaining_frames import SolutionTrack
from getagrip.fitting.stages.surface_motion import SURFACE_MOTION, turn_with_surface
from getagrip.geometry import se3
from getagrip.geometry.mesh import subdivide_surface
from getagrip.geometry.rasterize import depth_and_face, interpolate_vertex_values
from getagrip.provenance import estimated

FRAMES, TURN_DEG = 8, 3.0


def spinning(kind: str, folder: Path, textured: bool = True) -> tuple[Problem, SolutionTrack]:
    """Film an object that turns steadily about its z axis; return the problem, and poses that do not turn with it.

    A surface without texture has a highlight, which stays where it is.
    """
    clip, _ = getagrip.synthesise(kind, seed=0)
    clip = clip.take(np.zeros(FRAMES, int))
    clip = replace(clip, frames=tuple(f"{n:06d}" for n in range(FRAMES)), times=None)
    assert clip.truth is not None
    turn = np.radians(TURN_DEG) * np.arange(FRAMES)
    T = clip.truth.T_cam_obj @ se3.rotation_about_line(clip.mesh.centre, np.array([0.0, 0.0, 1.0]), turn)
    clip = replace(clip, provenance=clip.provenance | {"hands": estimated("by a test")})
    vertices, faces = subdivide_surface(clip.mesh.vertices, clip.mesh.faces, clip.mesh.diameter / 60)
    rng, images, masks = np.random.default_rng(0), [], []
    waves = np.sin(vertices @ rng.normal(0.0, 50.0 / clip.mesh.diameter, (3, 6)) + rng.uniform(0.0, 6.0, 6))
    for pose, K in zip(T, clip.K, strict=True):
        posed = se3.transform(pose, vertices)
        grey = 120.0 + (20.0 * waves.sum(axis=1) if textured else np.zeros(len(vertices)))
        face = depth_and_face(posed, faces, K, clip.size)[1]
        image = rng.normal(90.0, 2.0, (*face.shape, 3))
        image[face >= 0] += interpolate_vertex_values(posed, faces, K, face, np.repeat(grey[:, None], 3, axis=1)) - 90.0
        if not textured:
            u = np.arange(clip.size[0]) - np.flatnonzero((face >= 0).any(axis=0)).mean()
            image[face >= 0] += np.broadcast_to(80.0 * np.exp(-((u / 15.0) ** 2))[:, None], image.shape)[face >= 0]
        images.append(np.clip(image, 0, 255).astype(np.uint8))
        masks.append(face >= 0)
    shown = Masks(np.array(masks), np.zeros_like(masks))
    read = getagrip.read_clip(getagrip.write_clip(clip, shown, folder, images=images))
    problem = prepare_problem(read, Options(inits=1))
    T_hand_obj = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    kind_of = tuple("sampled" for _ in clip.frames)
    track = SolutionTrack(clip.frames, kind_of, clip.hand.T_cam_hand, T_hand_obj[None], None, np.ones(FRAMES))  # type: ignore[arg-type]
    return problem, track


def turns_deg(track: SolutionTrack) -> Float[ndarray, "n"]:
    """Turns about the z axis from frame to frame."""
    R = track.T_hand_obj[0, :, :3, :3]
    return np.asarray(np.degrees(se3.log_so3(np.swapaxes(R[:-1], -1, -2) @ R[1:])[:, 2]))


def test_a_textured_can_that_turns_in_a_steady_hand_is_followed(tmp_path: Path) -> None:
    problem, still = spinning("can", tmp_path / "clip")
    assert not turns_deg(still).any()
    followed, notes = turn_with_surface(problem.clip, problem, still, 1.0)
    assert len(notes) == 1
    assert turns_deg(followed) == pytest.approx(TURN_DEG, abs=0.6)
    before, after = (se3.transform(track.T_hand_obj[0], problem.clip.mesh.centre[None]) for track in (still, followed))
    assert after == pytest.approx(before)
    both = replace(still, T_hand_obj=np.repeat(still.T_hand_obj, 2, axis=0))
    assert np.array_equal(turn_with_surface(problem.clip, problem, both, 1.0)[0].T_hand_obj[1], still.T_hand_obj[0])


def test_a_can_follows_its_hand_where_images_are_absent_or_left_out(tmp_path: Path) -> None:
    problem, still = spinning("can", tmp_path / "clip")
    left_out = replace(problem, options=replace(problem.options, without=(SURFACE_MOTION,)))
    measured: Clip = replace(problem.clip, provenance={})
    for clip, each in ((problem.clip, left_out), (measured, problem)):
        assert turn_with_surface(clip, each, still, 1.0)[0] is still
    for frame in problem.clip.frames[::2]:
        path = problem.clip.image_file(problem.clip.frames.index(frame))
        assert path is not None
        path.write_bytes(b"no image")
    assert turn_with_surface(problem.clip, problem, still, 1.0)[0] is still
    without: Clip = replace(problem.clip, evidence=problem.clip.evidence | {"texture": None})
    assert turn_with_surface(without, problem, still, 1.0)[0] is still


@pytest.mark.parametrize(("kind", "textured"), [("can", False), ("box", True)])
def test_plain_surfaces_and_other_shapes_are_not_turned(tmp_path: Path, kind: str, textured: bool) -> None:
    problem, still = spinning(kind, tmp_path / "clip", textured)
    assert turn_with_surface(problem.clip, problem, still, 1.0)[0] is still


def test_only_the_soft_hinge_is_turned(tmp_path: Path) -> None:
    """A baseline without turns in the hand stays without."""
    clip = spinning("can", tmp_path / "clip")[0].clip
    for method in ("static", "soft-hinge"):
        result = getagrip.reconstruct(clip, options=Options(inits=4, method=method, hands="as-given"))
        assert any("as its surface moves" in note for note in result.notes) == (method == "soft-hinge")
