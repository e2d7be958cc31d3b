"""Laws of the baselines: terms against finite differences and plain numpy, and what is found on made-up clips."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.scene import Options as ClipOptions
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.errors import GetagripError
from getagrip.evaluation import evaluate
from getagrip.fitting.contact import HandContacts, solid
from getagrip.fitting.energy import Local, Poses, Term, no_bound
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.interaction import InteractionTerm
from getagrip.fitting.energy.pull import PullTerm
from getagrip.fitting.energy.push import PushTerm
from getagrip.fitting.energy.reprojection import ReprojectionTerm
from getagrip.fitting.energy.smoothness import SmoothnessTerm, moments
from getagrip.fitting.methods import all_frames as joint
from getagrip.fitting.methods.homan import in_box
from getagrip.fitting.methods.homan_refine import Bodies, JointEnergy, descend
from getagrip.fitting.motion import Free
from getagrip.fitting.objective import energy_of
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem
from getagrip.fitting.reconstruct import reconstruct
from getagrip.fitting.search import TermsAt
from getagrip.fitting.solve import minimise
from getagrip.geometry import camera, se3
from getagrip.result import Reconstruction
from helpers.clips import box, small_clip

B, N = 2, 4
K4 = np.tile([560.0, 570.0, 128.0, 120.0], (N, 1))
BOX = box(0.1, 0.06, 0.04)


def random_poses(rng: np.random.Generator) -> Poses:
    R = se3.exp_so3(rng.normal(size=(B, N, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (B, N, 3))
    return Poses(R, centre, rng.uniform(0.8, 1.2, B))


def moved(poses: Poses, steps: ndarray, stretch: float = 0.0) -> Poses:
    """Poses after a local step of each frame (N, 6), and of the log scale."""
    R = se3.exp_so3(steps[:, 3:]) @ poses.R
    return Poses(R, poses.centre + steps[:, :3], poses.scale * np.exp(stretch))


def some_term(kind: str, rng: np.random.Generator) -> Term:
    points = rng.normal(0.0, 0.03, (N, 5, 3))
    match kind:
        case "consistency":
            hand = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.04, (N, 6, 3))
            return ContactConsistencyTerm(points[0], hand, 1e6 * np.arange(1.0, N + 1.0), delta=1e-3)
        case "smoothness":
            return SmoothnessTerm(moments(points[0]), 1e5)
        case "reprojection":
            return ReprojectionTerm(points, K4, rng.uniform(0.0, 256.0, (N, 5, 2)), 3.0)
        case _:
            return InteractionTerm(np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (N, 3)), 1e4)


KINDS = ("consistency", "smoothness", "reprojection", "interaction")


def total_hessian(local: Local) -> ndarray:
    """The whole Hessian (B, 7 N, 7 N), frames tied to each other."""
    H = np.zeros((B, N, 7, N, 7)) if local.across is None else local.across.copy()
    for n in range(N):
        H[:, n, :, n] += local.H[:, n]
    return H.reshape(B, 7 * N, 7 * N)


# Terms


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_of_the_terms(kind: str) -> None:
    rng = np.random.default_rng(3)
    term, poses = some_term(kind, rng), random_poses(rng)

    def energy(p: Poses) -> ndarray:
        return term(p, no_bound(p)).value.sum(axis=1)

    local, h = term(poses, no_bound(poses)), 1e-6
    scale = np.abs(local.g).max()
    for n in range(N):
        for k in range(6):
            step = np.zeros((N, 6))
            step[n, k] = h
            expected = (energy(moved(poses, step)) - energy(moved(poses, -step))) / (2.0 * h)
            np.testing.assert_allclose(local.g[:, n, k], expected, rtol=1e-4, atol=1e-5 * scale)
    still = np.zeros((N, 6))
    expected = (energy(moved(poses, still, h)) - energy(moved(poses, still, -h))) / (2.0 * h)
    np.testing.assert_allclose(local.g[..., 6].sum(axis=1), expected, rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(0, 10**6))
@settings(max_examples=8)
def test_hessians_of_the_terms_can_be_trusted(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = random_poses(rng)
    H = total_hessian(some_term(kind, rng)(poses, no_bound(poses)))
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), atol=1e-9 * np.abs(H).max())
    eigenvalues = np.linalg.eigvalsh(H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max()).all()


@given(st.integers(0, 10**6))
@settings(max_examples=15)
def test_consistency_lies_below_the_quadratic_that_is_minimised(seed: int) -> None:
    """For moves that shift the object only: squared distances are then quadratic, so small ones are compared."""
    rng = np.random.default_rng(seed)
    term, poses = some_term("consistency", rng), random_poses(rng)
    local = term(poses, no_bound(poses))
    step = np.zeros((N, 6))
    step[:, :3] = 1e-5 * rng.normal(size=(N, 3))
    x = np.concatenate([step, np.zeros((N, 1))], axis=1).ravel()
    model = local.value.sum(axis=1) + local.g.reshape(B, -1) @ x + 0.5 * x @ total_hessian(local) @ x
    after = moved(poses, step)
    assert (term(after, no_bound(after)).value.sum(axis=1) <= model * (1.0 + 1e-6)).all()


def in_rigid_hand(rng: np.random.Generator) -> tuple[Poses, ndarray]:
    """An object that keeps still in a hand before a moving camera, and points of the hand."""
    T_cam_hand = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5]) + rng.normal(size=(N, 3)))
    T = T_cam_hand @ se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(0.0, 0.05, 3))
    hand = se3.transform(T_cam_hand, rng.normal(0.0, 0.04, (6, 3)))
    poses = Poses(np.ascontiguousarray(T[None, :, :3, :3]), np.ascontiguousarray(T[None, :, :3, 3]), np.ones(1))
    return poses, hand


def test_an_object_still_in_the_hand_is_consistent() -> None:
    rng = np.random.default_rng(0)
    poses, hand = in_rigid_hand(rng)
    term = ContactConsistencyTerm(rng.normal(0.0, 0.03, (5, 3)), hand, np.full(N, 1e6))
    local = term(poses, no_bound(poses))
    np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
    np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


def test_consistency_does_not_hold_back_what_all_frames_do_alike() -> None:
    rng = np.random.default_rng(1)
    poses, hand = in_rigid_hand(rng)
    term = ContactConsistencyTerm(rng.normal(0.0, 0.03, (5, 3)), hand, np.full(N, 1e6))
    local = term(poses, no_bound(poses))
    assert local.across is not None
    # A shift in the object's frame, which keeps still in the hand's, and a change of the scale.
    shift = (poses.R[0] @ rng.normal(size=3)).reshape(N, 3)
    for common in (np.concatenate([shift, np.zeros((N, 4))], axis=1), np.tile(np.eye(7)[6], (N, 1))):
        held_back = (local.H[0] @ common[..., None])[..., 0] + np.einsum("iajb,jb->ia", local.across[0], common)
        np.testing.assert_allclose(held_back, 0.0, atol=1e-9 * np.abs(local.H).max())


def test_consistency_is_the_mean_difference_of_squared_distances() -> None:
    rng = np.random.default_rng(2)
    points, hand = rng.normal(0.0, 0.03, (5, 3)), rng.normal(0.0, 0.05, (N, 6, 3))
    poses, weight = random_poses(rng), np.arange(1.0, N + 1.0)
    value = ContactConsistencyTerm(points, hand, weight, delta=1e-12)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * points @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    D = np.sum((hand[:, None] - placed[..., None, :]) ** 2, axis=-1)
    expected = np.abs(D[:, :, None] - D[:, None]).mean(axis=(2, 3, 4)) @ weight
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_a_lost_step_gets_no_derivatives_of_consistency() -> None:
    rng = np.random.default_rng(4)
    term, poses = some_term("consistency", rng), random_poses(rng)
    for bound in (np.zeros(B), np.full(B, np.nan)):
        assert not term(poses, bound).g.any()


def test_smoothness_is_the_mean_square_of_the_vertices_steps() -> None:
    rng = np.random.default_rng(5)
    vertices, poses = rng.normal(0.01, 0.05, (40, 3)), random_poses(rng)
    value = SmoothnessTerm(moments(vertices), 7.0)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * vertices @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    expected = 7.0 * np.sum(np.diff(placed, axis=1) ** 2, axis=-1).mean(axis=-1).sum(axis=-1)
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_a_still_body_is_smooth_and_at_its_image() -> None:
    rng = np.random.default_rng(6)
    R, centre = se3.exp_so3(rng.normal(size=3)), np.array([0.02, -0.01, 0.5])
    poses = Poses(np.tile(R, (1, N, 1, 1)), np.tile(centre, (1, N, 1)), np.ones(1))
    points = rng.normal(0.0, 0.03, (5, 3))
    K = np.array([[560.0, 0.0, 128.0], [0.0, 570.0, 120.0], [0.0, 0.0, 1.0]])
    seen = np.tile(camera.project(K, points @ R.T + centre), (N, 1, 1))
    terms: list[Term] = [
        SmoothnessTerm(moments(points), 1e5),
        ReprojectionTerm(np.tile(points, (N, 1, 1)), K4, seen, 3.0),
        InteractionTerm(np.tile(centre, (N, 1)), 1e4),
    ]
    for term in terms:
        local = term(poses, no_bound(poses))
        np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
        np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["consistency", "smoothness"])
def test_where_the_camera_stands_does_not_matter(kind: str) -> None:
    rng = np.random.default_rng(7)
    term, poses = some_term(kind, rng), random_poses(rng)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    R, t = T[:3, :3], T[:3, 3]
    turned = Poses(R @ poses.R, poses.centre @ R.T + t, poses.scale)
    if isinstance(term, ContactConsistencyTerm):
        there: Term = replace(term, hand=se3.transform(T, term.hand))
    else:
        there = term
    np.testing.assert_allclose(term(poses, no_bound(poses)).value, there(turned, no_bound(turned)).value, rtol=1e-9)


# The solver, where frames are tied


class Tied:
    """A term that ties frames to each other by nothing."""

    name = "tied"

    def __init__(self, inner: Term) -> None:
        self.inner = inner

    def __call__(self, poses: Poses, bound: ndarray) -> Local:
        local = self.inner(poses, bound)
        return replace(local, across=np.zeros((*local.g.shape, *local.g.shape[1:])))


@pytest.mark.parametrize("free_scale", [False, True])
def test_tied_by_nothing_frames_are_solved_as_ever(free_scale: bool) -> None:
    rng = np.random.default_rng(8)
    poses = random_poses(rng)
    terms = [some_term("reprojection", rng), some_term("interaction", rng)]
    start = Free(poses.R, poses.centre, np.log(poses.scale), free_scale)
    T = np.tile(np.eye(4), (N, 1, 1))
    alone = minimise(start, terms, T, 4)
    tied = minimise(start, [Tied(term) for term in terms], T, 4)
    np.testing.assert_allclose(alone.energy, tied.energy, rtol=1e-6)
    np.testing.assert_allclose(alone.motion.centre, tied.motion.centre, atol=1e-6)


def test_steps_of_tied_frames_are_newton_steps() -> None:
    """The smoothness of a body that may only be shifted is quadratic, and its minimum between two images known."""
    rng = np.random.default_rng(9)
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (1, N, 3))
    start = Free(np.tile(np.eye(3), (1, N, 1, 1)), centre, np.zeros(1))
    smooth, fixed = SmoothnessTerm(moments(np.zeros((1, 3))), 2e5), InteractionTerm(centre[0].copy(), 1e5)
    chain = 2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    chain[0, 0] = chain[-1, -1] = 1.0
    expected = np.linalg.solve(1e5 * np.eye(N) + 2e5 * chain, 1e5 * centre[0])
    found = minimise(start, [smooth, fixed], np.tile(np.eye(4), (N, 1, 1)), 12, tolerance=1e-12).motion.centre[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)


# HOMan's steps


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_an_object_is_placed_in_its_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = se3.exp_so3(rng.normal(size=(6, 3)))
    K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    low = rng.uniform(0.0, 400.0, 2)
    seen = np.concatenate([low, low + rng.uniform(40.0, 120.0, 2)])
    centre = in_box(R, BOX.vertices, K, seen)
    uv = camera.project(K, BOX.vertices @ np.swapaxes(R, 1, 2) + centre[:, None])
    least, most = uv.min(axis=1), uv.max(axis=1)
    np.testing.assert_allclose((least + most) / 2.0, np.tile((seen[:2] + seen[2:]) / 2.0, (6, 1)), atol=0.5)
    np.testing.assert_allclose(np.linalg.norm(most - least, axis=1), np.linalg.norm(seen[2:] - seen[:2]), rtol=0.02)


def joint_scene(seed: int = 0) -> tuple[JointEnergy, Bodies]:
    """Object and hand near each other, the hand a little off where it was given; all terms but the mask."""
    rng = np.random.default_rng(seed)
    given_hand = se3.rigid(
        se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.01, (N, 3))
    )
    grip = rng.normal(0.0, 0.01, (N, 3))
    points = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.03, (N, 26, 3))
    contacts, weight = HandContacts(points, np.arange(0, 24, 4)), np.full(N, 1e5)
    body = solid(BOX, BOX.centre)
    energy = JointEnergy(
        seen_object=[SmoothnessTerm(moments(BOX.vertices), 1e5)],
        seen_hand=[some_term("reprojection", rng), SmoothnessTerm(moments(points[0] - points[0].mean(0)), 1e5)],
        held=[
            PushTerm(body, contacts, weight, delta=1e-9),
            PullTerm(body, contacts, weight, delta=1e-9),
            some_term("interaction", rng),
        ],
        T_cam_hand=given_hand,
    )
    hand_centre = se3.transform(given_hand, grip[:, None])[:, 0]
    bodies = Bodies(
        R=se3.exp_so3(rng.normal(size=(N, 3))),
        centre=np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.005, (N, 3)),
        log_scale=0.05,
        hand_R=se3.exp_so3(rng.normal(0.0, 0.05, (N, 3))) @ given_hand[:, :3, :3],
        hand_centre=hand_centre + rng.normal(0.0, 0.005, (N, 3)),
        grip=grip,
    )
    return energy, bodies


def test_the_gradient_of_the_joint_energy() -> None:
    energy, bodies = joint_scene()
    values, g, H = energy(bodies)
    assert values["push"] > 0.0
    assert values["pull"] > 0.0
    h = 1e-7
    for n in range(N):
        for k in range(12):
            step = np.zeros((N, 12))
            step[n, k] = h
            ahead, behind = (sum(energy(bodies.moved(s * step, 0.0))[0].values()) for s in (1.0, -1.0))
            assert g[n, k] == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-3, abs=1e-4 * np.abs(g).max())
    still = np.zeros((N, 12))
    ahead, behind = (sum(energy(bodies.moved(still, s * h))[0].values()) for s in (1.0, -1.0))
    assert g[:, 12].sum() == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-3)
    np.testing.assert_allclose(H, np.swapaxes(np.swapaxes(H, 0, 1), 2, 3), atol=1e-9 * np.abs(H).max())


@pytest.mark.parametrize("free_scale", [False, True])
def test_descent_goes_down_and_keeps_a_known_scale(free_scale: bool) -> None:
    energy, bodies = joint_scene(1)
    found = descend(energy, bodies, 5, free_scale)
    assert found.energy < sum(energy(bodies)[0].values())
    assert found.energy == pytest.approx(sum(energy(found.bodies)[0].values()))
    assert (found.bodies.log_scale == bodies.log_scale) == (not free_scale)


def test_an_unmoved_hand_holds_the_object_where_the_camera_sees_it() -> None:
    energy, bodies = joint_scene(2)
    given_hand = energy.T_cam_hand
    same = replace(
        bodies,
        hand_R=given_hand[:, :3, :3],
        hand_centre=se3.transform(given_hand, bodies.grip[:, None])[:, 0],
    )
    np.testing.assert_allclose(same.T_cam_hand, given_hand, atol=1e-12)
    centre = np.array([0.1, 0.2, 0.3])
    middle = se3.transform(given_hand @ same.T_hand_obj(centre), same.scale * centre[None])[:, 0]
    np.testing.assert_allclose(middle, same.centre, atol=1e-12)


# On made-up clips

SMALL = ClipOptions(frames=8, size=(320, 240), focal=300.0)
BASELINES = ("single-frame", "homan", "contact-consistency")


@cache
def made(category: str, seed: int, options: ClipOptions = SMALL) -> tuple[Clip, Masks]:
    return synthesise(category, seed, options)


@cache
def found(method: Any, category: str, seed: int, options: ClipOptions = SMALL) -> Reconstruction:
    return reconstruct(*made(category, seed, options), Options(method=method))


def scores(result: Reconstruction, clip: Clip, masks: Masks) -> dict[str, float]:
    return evaluate(result, clip, masks)["metrics"]


@pytest.mark.parametrize("method", BASELINES)
def test_a_kettle_is_recovered(method: str) -> None:
    metrics = scores(found(method, "kettle", 1), *made("kettle", 1))
    assert metrics["add_sym_success"] == 1.0
    assert metrics["iou"] > 0.9


@pytest.mark.parametrize("method", BASELINES)
def test_an_unknown_scale_is_recovered(method: str) -> None:
    options = replace(SMALL, scale="free")
    metrics = scores(found(method, "kettle", 1, options), *made("kettle", 1, options))
    assert abs(metrics["scale_error"]) < 0.15
    assert metrics["iou"] > 0.85


@pytest.mark.parametrize("method", BASELINES)
def test_what_a_result_holds(method: str) -> None:
    result = found(method, "kettle", 1)
    assert result.method == method
    assert result.options["method"] == method
    assert result.frames == made("kettle", 1)[0].frames
    assert se3.is_rigid(result.T_hand_obj).all()
    assert result.axis is None
    np.testing.assert_array_equal(result.candidates.T_hand_obj[0], result.T_hand_obj)
    assert (np.diff(result.candidates.energy) >= 0.0).all()
    assert sum(v for k, v in result.energy.items() if k != "total") == pytest.approx(result.energy["total"])


def test_a_single_frame_knows_nothing_of_the_others() -> None:
    clip, masks = made("spoon", 1)
    back = np.arange(len(clip))[::-1]
    options = Options(method="single-frame", inits=12)
    forth = reconstruct(clip, masks, options)
    reverse = reconstruct(clip.take(back), Masks(masks.object[back], masks.ignore[back]), options)
    np.testing.assert_allclose(reverse.T_hand_obj[back], forth.T_hand_obj, atol=1e-6)


def test_consistency_holds_the_object_stiller_than_dynamic() -> None:
    def spread(result: Reconstruction) -> float:
        held = se3.transform(result.T_hand_obj, made("mug", 2)[0].mesh.vertices)
        return float(np.linalg.norm(held - held.mean(axis=0), axis=-1).mean())

    assert spread(found("contact-consistency", "mug", 2)) < spread(found("dynamic", "mug", 2))


@pytest.mark.parametrize("method", ["static", "one-dof", "dynamic", "soft-hinge", "contact-consistency"])
def test_contact_weighs_more_where_no_other_term_ties_the_object_to_the_hand(
    method: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = {}

    def asks(problem: Problem, push: float, pull: float) -> TermsAt:
        asked.update(push=push, pull=pull)
        return energy_of(problem, push, pull)

    monkeypatch.setattr(joint, "energy_of", asks)
    options = Options(method=method, inits=4)
    reconstruct(*small_clip(), options)
    heavy = 1.0 if method in ("soft-hinge", "contact-consistency") else joint.ALONE
    assert asked == {"push": heavy * options.push, "pull": heavy * options.pull}


@pytest.mark.parametrize("method", BASELINES)
def test_a_hand_behind_the_camera_is_told(method: Any) -> None:
    clip, masks = small_clip()
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    hand = replace(clip.hand, T_cam_hand=mirror @ clip.hand.T_cam_hand @ mirror)
    with pytest.raises(GetagripError, match="behind the camera"):
        reconstruct(replace(clip, hand=hand, truth=None), masks, Options(method=method, inits=4))
