"""The prior of an unmeasured object's category: grasps with the handle on every side, upright axis, and size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import getagrip
from getagrip.checks import RESULT_CHECKS, Evidence, run_checks
from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.methods.all_frames import coarse_energy
from getagrip.fitting.motion import Fixed, transform_poses
from getagrip.fitting.objective import handle_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import ObjectSurface, Problem, prepare_problem
from getagrip.fitting.solver.category_prior import (
    SIDE_REFLECTIONS,
    SizeTerm,
    UprightTerm,
    category_energy,
    category_rotations,
    handle_half_turns,
    handle_poses,
    opening_angle,
    unmeasured_kind,
)
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.geometry import se3
from getagrip.hands.grips import CATEGORY_PRIORS
from getagrip.hands.model import Side
from getagrip.provenance import Source, assumed
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip
from helpers.scenes import SHORT, scene
from helpers.terms import B, N, moved, random_poses

UNMEASURED = {"mesh": assumed("a mug of this package's own"), "scale": assumed("unknown")}


def unmeasured(seed: int = 0, options: SceneOptions = SHORT) -> tuple[Clip, Masks]:
    """A clip of a mug about which nothing but its kind is known."""
    clip, masks = scene("mug", seed, replace(options, scale="free", cad="mean"))
    return replace(clip, provenance={**clip.provenance, **UNMEASURED}), masks


@pytest.mark.parametrize(
    "change", [{"scale": "known"}, {"provenance": {"mesh": Source("scan.ply")}}, {"category": "x"}]
)
def test_a_measured_object_has_no_category_grasps_and_terms(change: dict[str, object]) -> None:
    clip = replace(unmeasured()[0], **change)
    assert unmeasured_kind(clip) is None
    assert len(category_rotations(clip)) == 0
    assert not category_energy(clip)(64, np.arange(len(clip)))


def test_energies_of_measured_objects_have_no_other_terms() -> None:
    clip, masks = scene("mug", 0, SHORT)
    named = {term.name for term in coarse_energy(prepare_problem(with_masks(clip, masks), Options()))(64, np.arange(4))}
    clip, masks = unmeasured()
    more = {term.name for term in coarse_energy(prepare_problem(with_masks(clip, masks), Options()))(64, np.arange(4))}
    assert named == {"mask", "push", "pull", "handle"}
    assert more == named | {"size", "upright", "opening"}


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_handle_is_tried_on_every_side(side: str) -> None:
    R = category_rotations(replace(unmeasured()[0], side=side))
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    usual = CATEGORY_PRIORS["mug"].grips[0].R_hand_obj
    usual = usual if side == "right" else SIDE_REFLECTIONS[0] @ usual @ SIDE_REFLECTIONS[1]
    for angle in np.linspace(0.0, 2.0 * np.pi, 25):
        turned = usual @ se3.exp_so3(np.array([0.0, 0.0, angle]))
        assert np.degrees(se3.angle_between(R, turned)).min() < 23.0


def test_category_rotations_are_the_first_and_at_most_half() -> None:
    clip, masks = unmeasured()
    usual = category_rotations(clip)
    few, many = (initial_poses(clip, masks, count, usual=usual) for count in (10, 100))
    np.testing.assert_array_equal(few.R[:5], usual[:5])
    np.testing.assert_array_equal(many.R[: len(usual)], usual)
    np.testing.assert_array_equal(few.R[5:], initial_poses(clip, masks, 5).R)
    np.testing.assert_array_equal(initial_poses(clip, masks, 10, usual=usual[:0]).R, initial_poses(clip, masks, 10).R)


@pytest.mark.parametrize("side", ["left", "right"])
def test_starts_have_the_handle_within_the_fingers(side: Side) -> None:
    clip, masks = unmeasured(options=replace(SHORT, side=side))
    problem = prepare_problem(with_masks(clip, masks), Options())
    initial = initial_poses(clip, masks, 10)
    poses = handle_poses(problem, initial)
    (term,) = handle_energy(problem)(256, np.arange(len(problem.clip)))
    found = term(*in_camera(problem, poses)).value.sum(axis=1)
    assert len(found) == 7
    assert (found < 0.8 * found.min()).sum() >= 5
    np.testing.assert_array_equal(poses.log_scale, initial.log_scale[0])
    measured = replace(problem, clip=replace(problem.clip, scale="known"))
    assert len(handle_poses(measured, initial).R) == 0
    assert problem.handle is not None
    ends = problem.handle[[0, -1]] + problem.clip.mesh.centre
    marked, without = (replace(problem, clip=replace(problem.clip, handle=line)) for line in (ends, ends[:0]))
    assert marked.handle is not None
    np.testing.assert_allclose(marked.handle[[0, -1]], problem.handle[[0, -1]], atol=1e-12)
    assert without.handle is None
    left_out = replace(problem, options=Options(without=("handle",)))
    assert len(handle_poses(left_out, initial).R) == 0
    assert not handle_energy(left_out)(256, np.arange(len(problem.clip)))


def in_camera(problem: Problem, poses: Fixed) -> tuple[PosesInCamera, np.ndarray]:
    """Return poses at a problem's frames in the camera frame, and no bound."""
    in_hand = replace(poses, frames=len(problem.clip)).poses()
    moved = transform_poses(in_hand, problem.clip.hand.T_cam_hand)
    at = PosesInCamera(moved.R, moved.centre, moved.scale)
    return at, no_bound(at)


def test_it_is_said_where_the_handle_decided() -> None:
    clip = small_clip()
    said = [
        [*run_checks([RESULT_CHECKS["handle-decided"]], Evidence(*clip, handle_decided=by))[1]] for by in (0.0, 0.03)
    ]
    assert not said[0]
    assert "by 3 %" in str(said[1][0])


def test_only_objects_nearly_upside_down_cost() -> None:
    axes = np.tile(np.array([0.0, 0.0, 1.0]), (N, 1, 1))

    def value(*turns: tuple[float, float, float]) -> np.ndarray:
        R = np.tile(se3.exp_so3(np.array(turns))[:, None], (1, N, 1, 1))
        poses = PosesInCamera(R, np.zeros((len(turns), N, 3)), np.ones(len(turns)))
        return np.asarray(UprightTerm(axes)(poses, no_bound(poses)).value[:, 0])

    about, tilted, beyond, over = value((0, 0, 2.0), (1.5, 0, 0), (1.8, 0, 0), (np.pi, 0, 0))
    assert about == tilted == 0.0
    assert 0.0 < beyond < over


def test_a_mug_has_its_opening_on_the_thumb_s_side() -> None:
    clip, _ = unmeasured()
    terms = category_energy(clip)(64, np.arange(len(clip)))
    assert [term.name for term in terms] == ["size", "upright", "opening"]
    assert clip.truth is not None
    T, ones = clip.truth.T_cam_obj, np.ones(2)
    over = np.diag([1.0, -1.0, -1.0])
    R = np.stack([T[:, :3, :3], T[:, :3, :3] @ over])
    poses = PosesInCamera(R, np.tile(T[:, :3, 3], (2, 1, 1)), ones)
    value = terms[1](poses, no_bound(poses)).value
    assert not value[0].any()
    assert value[1].all()
    assert [one.name for one in category_energy(replace(clip, category="can"))(64, np.arange(2))] == ["size"]


def test_a_mug_that_is_mirrored_in_depth_is_seen_from_below() -> None:
    """Its silhouette stays, but for perspective; what it opens to does not."""
    clip, _ = unmeasured()
    opening = category_energy(clip)(64, np.arange(len(clip)))[2]
    assert clip.truth is not None
    T = clip.truth.T_cam_obj
    ray = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=1, keepdims=True)
    in_depth = np.eye(3) - 2.0 * ray[:, :, None] * ray[:, None]
    R = np.stack([T[:, :3, :3], in_depth @ T[:, :3, :3] @ np.diag([1.0, -1.0, 1.0])])
    poses = PosesInCamera(R, np.tile(T[:, :3, 3], (2, 1, 1)), np.ones(2))
    value = opening(poses, no_bound(poses)).value
    assert not value[0].any()
    assert value[1].all()


@pytest.mark.parametrize("name", ["size", "upright"])
def test_derivatives(name: str) -> None:
    rng = np.random.default_rng(4)
    poses, h = random_poses(rng), 1e-6
    axes = rng.normal(size=(N, 3, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    term = SizeTerm(0.15) if name == "size" else UprightTerm(axes)
    found = term(poses, no_bound(poses))
    assert found.value.shape == (B, N)
    for k in range(7):
        step = h * np.eye(7)[k]
        up, down = (term(moved(poses, s * step), no_bound(poses)).value.sum(axis=1) for s in (1.0, -1.0))
        expected = (up - down) / (2.0 * h)
        np.testing.assert_allclose(found.g[..., k].sum(axis=1), expected, atol=1e-5 * np.abs(found.g).max())
    assert (np.linalg.eigvalsh(found.H) >= -1e-9 * np.abs(found.H).max()).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_handle_is_found_or_its_side_is_among_the_candidates(seed: int) -> None:
    """A mug of another shape than its mesh, of unknown size, in a hand that is not known exactly."""
    options = SceneOptions(
        frames=12, size=(320, 240), focal=300.0, deform=0.01, hand_bias_deg=6.0, hand_bias_mm=4.0, hand_jitter_deg=2.0
    )
    clip, masks = unmeasured(seed, options)
    result = getagrip.reconstruct(clip, masks)
    assert clip.truth is not None
    R_true = np.swapaxes(clip.hand.T_cam_hand[:, :3, :3], 1, 2) @ clip.truth.T_cam_obj[:, :3, :3]
    off = [
        np.degrees(np.arccos(np.clip(np.sum(R[:, :3, 0] * R_true[..., 0], axis=-1), -1.0, 1.0))).mean()
        for R in result.candidates.T_hand_obj
    ]
    assert min(off) < 45.0
    assert 0.75 < result.scale / clip.truth.scale < 1.33


def test_the_handle_on_the_other_side_is_always_a_candidate() -> None:
    clip, masks = unmeasured()
    found = reconstruct(clip, masks, Options(inits=12)).candidates
    R = found.T_hand_obj[:, 0, :3, :3]
    assert (np.degrees(se3.angle_between(R[0].T @ R, handle_half_turns(clip, surface_of(clip))[0])) < 60.0).any()


def test_an_opening_that_points_away_from_the_camera_is_measured_and_said() -> None:
    clip = unmeasured()[0]
    T_cam_obj = np.tile(np.eye(4), (len(clip), 1, 1))
    T_cam_obj[:, :3, 3] = 0.0, 0.0, 0.5
    for tilt in (-40.0, 30.0):  # of the opening, z, from square to the ray, towards the camera below 0
        T_cam_obj[:, :3, :3] = se3.exp_so3(np.array([np.radians(90.0 - tilt), 0.0, 0.0]))
        T = se3.inverse(clip.hand.T_cam_hand) @ T_cam_obj
        assert opening_angle(clip, T) == pytest.approx(tilt)
        given = Evidence(*small_clip(), turned_away=opening_angle(clip, T))
        said = [*map(str, run_checks([RESULT_CHECKS["opening-away"]], given)[1])]
        assert said == [] if tilt < 0.0 else "by 30 degrees" in said[0]
    assert np.isnan(opening_angle(replace(clip, category="plate"), T))
    assert np.isnan(opening_angle(replace(clip, scale="known"), T))


def test_only_objects_with_a_handle_have_an_opposite_side() -> None:
    clip = unmeasured()[0]
    for kind, turns in (("mug", 1), ("pan", 1), ("bottle", 0), ("plate", 0)):
        other = replace(clip, category=kind, mesh=SYNTHETIC_CATEGORIES[kind]())
        assert len(handle_half_turns(other, surface_of(other))) == turns
    assert len(handle_half_turns(replace(clip, scale="known"), surface_of(clip))) == 0


def surface_of(clip: Clip) -> ObjectSurface:
    """Return the surface of a clip's mesh."""
    return ObjectSurface.of(clip.mesh)
