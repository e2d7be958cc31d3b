"""Laws of the terms: zero at the truth, gradients against finite differences, Hessians that a solver can trust."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.datasets.synthetic import shapes
from getagrip.fitting.contact import HandContacts, solid, spread_points
from getagrip.fitting.energy import Local, Poses, Term, no_bound
from getagrip.fitting.energy.mask import MaskTerm, Surface
from getagrip.fitting.energy.pull import PullTerm
from getagrip.fitting.energy.push import PushTerm
from getagrip.fitting.observation import CROP, LEVELS, Observation, observe
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.kernels import reference
from getagrip.kernels.silhouette import mismatch, pack, silhouettes, unpack
from helpers.clips import box, small_clip

SIZE = 300
CAMERA = np.array([[560.0, 0.0, 148.0], [0.0, 570.0, 152.0], [0.0, 0.0, 1.0]])
MESHES = {"box": box(0.1, 0.06, 0.04), "mug": shapes.mug(), "spoon": shapes.spoon()}


def poses_at(R: ndarray, centre: ndarray, scale: float = 1.0) -> Poses:
    return Poses(R[None], centre[None], np.array([scale]))


def moved(poses: Poses, step: ndarray) -> Poses:
    """Poses after a local 7-vector."""
    return Poses(se3.exp_so3(step[3:6]) @ poses.R, poses.centre + step[:3], poses.scale * np.exp(step[6]))


def rendered(mesh: Mesh, poses: Poses, K: ndarray, shape: tuple[int, int]) -> ndarray:
    """Masks (N, h, w) of the first hypothesis."""
    t = Surface.of(mesh, mesh.centre)
    N = len(K)
    bits = np.empty((N, shape[0], -(-shape[1] // 64)), np.uint64)
    scale = np.full(N, poses.scale[0])
    silhouettes(poses.R[0], poses.centre[0], scale, t.vertices, t.planes, t.edges, t.closed, K, bits)
    return unpack(bits, shape[1])


def scene(which: str, seed: int = 0, frames: int = 2, occluded: bool = False) -> tuple[MaskTerm, Poses]:
    """A term whose masks were drawn at the poses that come with it."""
    rng = np.random.default_rng([seed, *which.encode()])
    mesh = MESHES[which]
    R = se3.exp_so3(rng.normal(size=(frames, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.02, 0.02, (frames, 3))
    truth = poses_at(R, centre)
    K4 = np.tile(CAMERA[[0, 1, 0, 1], [0, 1, 2, 2]], (frames, 1))
    seen = rendered(mesh, truth, K4, (SIZE, SIZE))
    ignore = np.zeros_like(seen)
    if occluded:
        i, j = np.indices((SIZE, SIZE))
        ignore[:] = (i - 0.6 * j > 90.0) & (i - 0.6 * j < 125.0)
    observation = observe(Masks(seen & ~ignore, ignore), np.tile(CAMERA, (frames, 1, 1)))
    # Drawn again in the crops, so that no pixel differs at the truth.
    care = unpack(observation.care[CROP], CROP)
    exact = pack(rendered(mesh, truth, observation.K, (CROP, CROP)) & care)
    observation = replace(observation, seen={**observation.seen, CROP: exact})
    return MaskTerm(Surface.of(mesh, mesh.centre), observation), truth


def differences(energy: object, poses: Poses, steps: ndarray) -> ndarray:
    """Central differences (B, N, 7) of per-frame energies (B, N) by the local 7-vector, step by step."""
    out = []
    for k, step in enumerate(steps):
        ahead, behind = (moved(poses, sign * step * np.eye(7)[k]) for sign in (1.0, -1.0))
        out.append((energy(ahead) - energy(behind)) / (2.0 * step))  # type: ignore[operator]
    return np.stack(out, axis=-1)


def is_trustworthy(local: Local) -> None:
    """Every Hessian is symmetric and positive semi-definite."""
    np.testing.assert_array_equal(local.H, np.swapaxes(local.H, -1, -2))
    eigenvalues = np.linalg.eigvalsh(local.H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max(initial=1.0)).all()


# E_mask


@pytest.mark.parametrize("which", sorted(MESHES))
@pytest.mark.parametrize("occluded", [False, True])
def test_e_mask_is_zero_at_the_truth_and_positive_elsewhere(which: str, occluded: bool) -> None:
    term, truth = scene(which, occluded=occluded)
    np.testing.assert_array_equal(term(truth, no_bound(truth)).value, 0.0)
    off = moved(truth, np.array([0.005, 0.0, 0.0, 0.0, 0.1, 0.0, 0.02]))
    assert (term(off, no_bound(off)).value > 10.0).all()


def smooth_energy(term: MaskTerm, mesh: Mesh, poses: Poses, finer: int = 8) -> ndarray:
    """E_mask (1, N) of silhouettes drawn finer than the masks, as ``reference.mask_energy`` says."""
    o = term.observation
    grow = np.ones((finer, finer), bool)
    drawn = pack(rendered(mesh, poses, o.K * finer, (CROP * finer, CROP * finer)))
    energy = [
        mismatch(drawn[n], *(pack(np.kron(unpack(bits[CROP][n], CROP), grow)) for bits in (o.seen, o.care)))
        for n in range(len(drawn))
    ]
    return np.array([energy]) / finer**2


def test_a_finer_energy_is_what_the_specification_says() -> None:
    term, truth = scene("box", frames=1, occluded=True)
    mesh, o = MESHES["box"], term.observation
    off = moved(truth, np.array([0.004, -0.002, 0.01, 0.1, -0.05, 0.08, 0.03]))
    uvz = reference.project(mesh.vertices - mesh.centre, off.R[0, 0], off.centre[0, 0], off.scale[0], o.K[0])
    seen, care = (unpack(bits[CROP][0], CROP) for bits in (o.seen, o.care))
    assert smooth_energy(term, mesh, off, finer=3)[0, 0] == reference.mask_energy(uvz, mesh.faces, seen, care, finer=3)


@pytest.mark.parametrize("occluded", [False, True])
def test_the_contour_gives_the_gradient_of_e_mask(occluded: bool) -> None:
    """Away from the observed outline and the occluder's, that is: there E_mask has kinks, which delta rounds off."""
    cosines, ratios = [], []
    for which in ("box", "mug"):
        mesh = MESHES[which]
        radius = mesh.diameter / 2.0
        unit = np.array([radius, radius, radius, 1.0, 1.0, 1.0, 1.0])
        for seed in range(2):
            term, truth = scene(which, seed, occluded=occluded)
            rng = np.random.default_rng(seed)
            step = 0.06 * unit * rng.uniform(-1.0, 1.0, 7)
            step[6] = (-0.12, 0.12)[seed]
            off = moved(truth, step)
            local = replace(term, step=1.0, delta=1e-3)(off, no_bound(off))
            pixel = off.centre[..., 2].mean() / (term.observation.K[0, 0] * radius)

            def energy(poses: Poses, term: MaskTerm = term, mesh: Mesh = mesh) -> ndarray:
                return smooth_energy(term, mesh, poses)

            expected = unit * differences(energy, off, 0.5 * pixel * unit)
            found = unit * local.g
            lengths = np.linalg.norm(found, axis=-1), np.linalg.norm(expected, axis=-1)
            cosines.append(np.sum(found * expected, axis=-1) / (lengths[0] * lengths[1]))
            ratios.append(lengths[0] / lengths[1])
    assert np.mean(cosines) > 0.999
    assert np.mean(np.abs(np.array(ratios) - 1.0)) < 0.02


@settings(max_examples=10)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6), st.sampled_from(LEVELS), st.sampled_from([0.0, 1.0]))
def test_hessians_of_e_mask(which: str, seed: int, level: int, coverage: float) -> None:
    term, truth = scene(which, seed % 3)
    step = np.random.default_rng(seed).normal(0.0, 0.1, 7) * [0.1, 0.1, 0.1, 1, 1, 1, 1]
    off = moved(truth, step)
    is_trustworthy(replace(term, level=level, coverage=coverage)(off, no_bound(off)))


def test_levels_agree_on_the_energy() -> None:
    term, truth = scene("mug")
    off = moved(truth, np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]))
    values = [replace(term, level=level)(off, no_bound(off)).value for level in LEVELS]
    for value in values[:-1]:
        np.testing.assert_allclose(value, values[-1], rtol=0.15)


def test_hidden_pixels_say_nothing() -> None:
    """An object that moves behind an occluder costs nothing and feels nothing."""
    term, truth = scene("box", frames=1)
    seen, care = (unpack(bits[CROP], CROP) for bits in (term.observation.seen, term.observation.care))
    hidden = replace(term.observation, care={**term.observation.care, CROP: pack(np.zeros_like(care))})
    off = moved(truth, np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]))
    local = replace(term, observation=hidden)(off, no_bound(off))
    assert seen.any()
    for array in (local.value, local.g, local.H):
        assert not array.any()


def test_beyond_the_bound_only_the_value_is_known() -> None:
    term, truth = scene("box")
    off = moved(truth, np.full(7, 0.03))
    full = term(off, no_bound(off))
    total = full.value.sum(axis=1)
    for bound, known in ((total + 1.0, True), (total - 1.0, False)):
        local = term(off, bound)
        np.testing.assert_array_equal(local.value, full.value)
        np.testing.assert_array_equal(local.g, full.g if known else 0.0)
        np.testing.assert_array_equal(local.H, full.H if known else 0.0)


def test_an_object_at_the_camera_has_infinite_energy() -> None:
    term, truth = scene("box")
    """Whichever frame it is that nothing can be drawn of; the solver asks for derivatives without a bound."""
    for frames in ([0], [1], [0, 1]):
        centre = truth.centre.copy()
        centre[:, frames, 2] *= -1.0
        near = Poses(truth.R, centre, truth.scale)
        local = term(near, no_bound(near))
        assert np.isinf(local.value.sum())
        assert not local.g.any()


def test_observed_points_pull_an_object_that_overlaps_nothing() -> None:
    """Two spoons side by side: the area's gradient only shrinks the misplaced one, coverage moves it home."""
    term, truth = scene("spoon", frames=1)
    away = np.zeros(7)
    away[0] = 0.02
    off = moved(truth, away)
    coarse = replace(term, level=64, step=1.0, delta=2.0)
    with_coverage = replace(coarse, coverage=1.0)(off, no_bound(off)).g[0, 0, :3]
    without = coarse(off, no_bound(off)).g[0, 0, :3]
    home = -np.array([1.0, 0.0, 0.0])
    assert -with_coverage @ home > abs(-without @ home)


# E_push and E_pull


def contacts(rng: np.random.Generator, frames: int, spread: float = 0.03) -> HandContacts:
    """Five fingertips of four vertices each, and a palm of six, about half a metre before the camera."""
    position = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, spread, (frames, 26, 3))
    return HandContacts(position, np.arange(0, 24, 4))


def physical_terms(mesh: Mesh, hand: HandContacts, delta: float = 0.002) -> tuple[PushTerm, PullTerm]:
    frames = len(hand.position)
    body, weight = solid(mesh, mesh.centre), 1000.0 * np.arange(1, frames + 1)
    # Half a millimetre, for the mug's wall is thin.
    return PushTerm(body, hand, weight, give=5e-4, delta=delta), PullTerm(body, hand, weight, delta=delta)


def random_poses(rng: np.random.Generator, hypotheses: int, frames: int) -> Poses:
    R = se3.exp_so3(rng.normal(size=(hypotheses, frames, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.01, (hypotheses, frames, 3))
    return Poses(R, centre, rng.uniform(0.8, 1.2, hypotheses))


def heights(mesh: Mesh, hand: HandContacts, poses: Poses, b: int, n: int) -> ndarray:
    """Signed distances of the contact vertices to the posed object, by the specification [m]."""
    local = (hand.position[n] - poses.centre[b, n]) @ poses.R[b, n] / poses.scale[b]
    corners = mesh.vertices[mesh.faces] - mesh.centre
    return poses.scale[b] * reference.signed_distance(local, corners, mesh.planes[:, :3])[0]


@pytest.mark.parametrize("which", sorted(MESHES))
def test_push_and_pull_are_what_the_specification_says(which: str) -> None:
    rng = np.random.default_rng(5)
    mesh, hand, poses = MESHES[which], contacts(rng, 3), random_poses(rng, 2, 3)
    hand.position[:, ::2] += 0.5 * (poses.centre[0, :, None] - hand.position[:, ::2])  # some inside
    push, pull = physical_terms(mesh, hand)
    pushed, pulled = (term(poses, no_bound(poses)).value for term in (push, pull))
    for b in range(2):
        for n in range(3):
            d = heights(mesh, hand, poses, b, n)
            # A distance grid knows the nearest face but for a few points, most of them halfway between two.
            expected = reference.push(d, push.weight[n], push.give)
            assert pushed[b, n] == pytest.approx(expected, abs=1e-4 * push.weight[n])
            expected = reference.pull(d, hand.region, pull.weight[n], pull.reach)
            assert pulled[b, n] == pytest.approx(expected, abs=1e-4 * pull.weight[n])


@pytest.mark.parametrize("name", ["push", "pull"])
@pytest.mark.parametrize("which", sorted(MESHES))
def test_gradients_of_push_and_pull(name: str, which: str) -> None:
    rng = np.random.default_rng(11)
    hand = contacts(rng, 3)
    mesh = MESHES[which]
    term = physical_terms(mesh, hand, delta=1e-9)[name == "pull"]
    poses = random_poses(rng, 4, 3)
    for n in range(3):  # some vertices just below the surface of the first hypothesis
        face = rng.integers(len(mesh.faces), size=8)
        depth = rng.uniform(6e-4, 2e-3, (8, 1))
        inside = mesh.vertices[mesh.faces[face]].mean(axis=1) - depth * mesh.planes[face, :3] - mesh.centre
        hand.position[n, ::3][:8] = poses.scale[0] * inside @ poses.R[0, n].T + poses.centre[0, n]
    local = term(poses, no_bound(poses))
    assert (local.value[0] > 0).all()
    expected = differences(lambda p: term(p, no_bound(p)).value, poses, np.full(7, 1e-7))
    np.testing.assert_allclose(local.g, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@settings(max_examples=15)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6))
def test_hessians_of_push_and_pull(which: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand, poses = contacts(rng, 2), random_poses(rng, 2, 2)
    for term in physical_terms(MESHES[which], hand):
        is_trustworthy(term(poses, no_bound(poses)))


def test_nothing_pushes_outside() -> None:
    rng = np.random.default_rng(1)
    mesh = MESHES["box"]
    direction = rng.normal(size=(2, 26, 3))
    far = np.array([0.0, 0.0, 0.5]) + 0.065 * direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    hand = HandContacts(far, np.arange(0, 24, 4))
    poses = Poses(np.tile(np.eye(3), (1, 2, 1, 1)), np.tile([0.0, 0.0, 0.5], (1, 2, 1)), np.ones(1))
    local = physical_terms(mesh, hand)[0](poses, no_bound(poses))
    for array in (local.value, local.g, local.H):
        assert not array.any()


def test_a_little_depth_does_not_push() -> None:
    mesh, give = MESHES["box"], 0.004
    face, out = mesh.vertices[mesh.faces[0]].mean(axis=0) - mesh.centre, mesh.planes[0, :3]
    poses = Poses(np.eye(3)[None, None], np.array([[[0.0, 0.0, 0.5]]]), np.ones(1))
    for depth in (0.0, 0.9 * give, 1.5 * give):
        hand = HandContacts(np.tile(poses.centre[0, 0] + face - depth * out, (1, 26, 1)), np.arange(0, 24, 4))
        local = PushTerm(solid(mesh, mesh.centre), hand, np.ones(1), give=give)(poses, no_bound(poses))
        assert local.value[0, 0] == pytest.approx(max(0.0, depth - give), abs=1e-6)
        assert local.g.any() == (depth > give)


def test_fingers_on_the_surface_do_not_pull() -> None:
    rng = np.random.default_rng(2)
    mesh = MESHES["mug"]
    hand, poses = contacts(rng, 1), random_poses(rng, 1, 1)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=5)]] - mesh.centre
    touching = poses.scale[0] * corners.mean(axis=1) @ poses.R[0, 0].T + poses.centre[0, 0]
    hand.position[0, hand.region[:5]] = touching
    local = physical_terms(mesh, hand)[1](poses, no_bound(poses))
    np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
    np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


def test_a_far_finger_holds_nothing() -> None:
    rng = np.random.default_rng(3)
    hand, poses = contacts(rng, 1), random_poses(rng, 1, 1)
    hand.position[:] = poses.centre[0] + [0.5, 0.0, 0.0]
    push, pull = physical_terms(MESHES["mug"], hand)
    local = pull(poses, no_bound(poses))
    np.testing.assert_allclose(local.value, pull.weight[0] * pull.reach)
    assert not local.g.any()
    assert not push(poses, no_bound(poses)).value.any()


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_contact_does_not_depend_on_where_it_is_seen_from(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand, poses = contacts(rng, 2), random_poses(rng, 2, 2)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    R, t = T[:3, :3], T[:3, 3]
    turned = Poses(R @ poses.R, poses.centre @ R.T + t, poses.scale)
    seen = replace(hand, position=se3.transform(T, hand.position.reshape(-1, 3)).reshape(hand.position.shape))
    for here, there in zip(physical_terms(MESHES["mug"], hand), physical_terms(MESHES["mug"], seen), strict=True):
        a, b = here(poses, no_bound(poses)), there(turned, no_bound(turned))
        np.testing.assert_allclose(a.value, b.value, atol=1e-6)
        # Translation and rotation turn with the camera, scale does not.
        np.testing.assert_allclose(a.g[..., :3] @ R.T, b.g[..., :3], atol=1e-3)
        np.testing.assert_allclose(a.g[..., 3:6] @ R.T, b.g[..., 3:6], atol=1e-3)
        np.testing.assert_allclose(a.g[..., 6], b.g[..., 6], atol=1e-3)


def test_hypotheses_do_not_know_of_each_other() -> None:
    rng = np.random.default_rng(4)
    mask, truth = scene("mug")
    hand, poses = contacts(rng, 2), random_poses(rng, 3, 2)
    terms: list[Term] = [mask, *physical_terms(MESHES["mug"], hand)]
    for term in terms:
        together = term(poses, no_bound(poses))
        for b in range(3):
            alone = term(Poses(poses.R[[b]], poses.centre[[b]], poses.scale[[b]]), np.full(1, np.inf))
            np.testing.assert_array_equal(alone.value[0], together.value[b])
            np.testing.assert_array_equal(alone.g[0], together.g[b])
    assert len(truth.scale) == 1


def test_contact_vertices_are_the_regions_fingertips_first() -> None:
    hand = small_clip()[0].hand
    contact = HandContacts.of(hand)
    assert contact.position.shape == (3, 12, 3)
    np.testing.assert_array_equal(contact.region, [0, 2, 4, 6, 8, 10])
    thumb = se3.transform(hand.T_cam_hand, hand.vertices[:, hand.regions["thumb"]])
    np.testing.assert_allclose(contact.position[:, :2], thumb)
    assert HandContacts.of(hand, per_region=1).position.shape == (3, 6, 3)
    np.testing.assert_array_equal(contact.take(np.array([2])).position, contact.position[[2]])


def test_spread_points_cover_a_line() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros((101, 2))])
    np.testing.assert_array_equal(spread_points(line, 3), [0, 50, 100])
    np.testing.assert_array_equal(spread_points(line[:2], 3), [0, 1])


def test_observation_is_not_changed_by_its_reader() -> None:
    term, truth = scene("box")
    before: Observation = replace(term.observation, targets=term.observation.targets.copy())
    term(truth, no_bound(truth))
    np.testing.assert_array_equal(before.targets, term.observation.targets)
