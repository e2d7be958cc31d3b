"""Laws of depth: derivatives by differences, a scale that is profiled out, holes, wrong depth that counts little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray
from scipy.optimize import minimize

from getagrip.clip.depth import DepthSource
from getagrip.fitting.energy import HandInCamera, ObjectWithHand, PosesInCamera, depth_term, no_bound
from getagrip.fitting.energy.depth_term import (
    DEPTH_TAIL_SIGMAS,
    N_DEPTH_SCALE_ERRORS,
    N_INDEPENDENT_SAMPLES,
    RAY_MISS_ERROR,
    DepthErrors,
    DepthSamples,
    DepthTerm,
    depth_errors_of,
)
from getagrip.geometry import se3
from getagrip.geometry.kernels.depth import WARP_STUDENT_DOF
from helpers.terms import FREE, METRIC, MIDDLE, N_DEPTH_POSES, is_trustworthy, poses, seen, term

ONE = np.ones(1)
STEP = 1e-6


def scene(seed: int, noise: float = 0.004) -> tuple[DepthSamples, PosesInCamera, PosesInCamera]:
    """Noisy samples of object and hand, and poses of both a little beside those."""
    rng = np.random.default_rng(seed)
    R, centre = poses(rng)
    hand = R @ se3.exp_so3(np.array([0.1, 0.2, 0.0])), centre + np.array([0.05, 0.03, -0.02])
    samples, log_z = seen(((R, centre), hand))
    samples = replace(samples, log_z=log_z + 0.05 + rng.normal(0.0, noise, log_z.shape))
    turn, shift = (
        se3.exp_so3(rng.normal(0.0, 0.02, (2, 1, N_DEPTH_POSES, 3))),
        rng.normal(0.0, 0.003, (2, 1, N_DEPTH_POSES, 3)),
    )
    of_object = PosesInCamera(turn[0] @ R, centre + shift[0], 1.02 * ONE)
    return samples, of_object, PosesInCamera(turn[1] @ hand[0], hand[1] + shift[1], 0.98 * ONE)


def with_hand(of_object: PosesInCamera, hand: PosesInCamera) -> ObjectWithHand:
    there = HandInCamera(*vars(hand).values(), MIDDLE)
    return ObjectWithHand(*vars(of_object).values(), there, of_object)


def turned(at: PosesInCamera, step: ndarray) -> PosesInCamera:
    """A body after a local vector (N, 7); its size by the sum over frames."""
    scale = at.scale * np.exp(step[:, 6].sum())
    return PosesInCamera(se3.exp_so3(step[:, 3:6]) @ at.R, at.centre + step[:, :3], scale)


@pytest.mark.parametrize("errors", [METRIC, FREE], ids=["metric", "free"])
@pytest.mark.parametrize("moves", [False, True], ids=["object", "both"])
def test_gradient_is_that_of_differences(monkeypatch: pytest.MonkeyPatch, errors: DepthErrors, moves: bool) -> None:
    monkeypatch.setattr(depth_term, "MAX_IRLS_ITERATIONS", 500)
    monkeypatch.setattr(depth_term, "IRLS_TOLERANCE", 1e-12)
    samples, of_object, hand = scene(0)
    one = term(samples, errors)

    def at(step: ndarray) -> PosesInCamera:
        there = turned(of_object, step[:, :7])
        return with_hand(there, turned(hand, step[:, 7:])) if moves else there

    P = 14 if moves else 7
    found = one(at(np.zeros((N_DEPTH_POSES, 14))), np.array([np.inf]))
    numeric = np.zeros((N_DEPTH_POSES, P))
    for n in range(N_DEPTH_POSES):
        for k in range(P):
            step = np.zeros((N_DEPTH_POSES, 14))
            step[n, k] = STEP
            ahead, behind = (one(at(sign * step), np.array([np.inf])).value.sum() for sign in (1.0, -1.0))
            numeric[n, k] = (ahead - behind) / (2.0 * STEP)
    sizes = [k for k in (6, 13) if k < P]
    analytic = found.g[0].copy()
    analytic[:, sizes] = found.g[0][:, sizes].sum(axis=0)  # which frames share
    np.testing.assert_allclose(analytic, numeric, rtol=1e-4, atol=1e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("moves", [False, True])
def test_curvature_can_be_trusted(moves: bool) -> None:
    samples, of_object, hand = scene(1)
    there = with_hand(of_object, hand) if moves else of_object
    found = term(samples, FREE)(there, no_bound(there))
    is_trustworthy(found)
    P = found.g.shape[-1]
    assert found.cross is not None
    whole = found.cross[0].copy()
    for n in range(N_DEPTH_POSES):
        whole[n, :, n] += found.H[0, n]
    whole = whole.reshape(N_DEPTH_POSES * P, N_DEPTH_POSES * P)
    np.testing.assert_allclose(whole, whole.T)
    assert np.linalg.eigvalsh(whole).min() > -1e-6 * np.abs(whole).max()


@pytest.mark.parametrize("errors", [METRIC, FREE], ids=["metric", "free"])
@pytest.mark.parametrize("moves", [False, True], ids=["object", "both"])
def test_curvature_is_that_of_differences_where_depth_fits(errors: DepthErrors, moves: bool) -> None:
    """Of all frames together, which the image's errors tie to each other; sizes are the same in all frames."""
    samples, _, _ = scene(3, noise=0.0)
    of_object, hand = true_poses(3)
    one = term(replace(samples, log_z=samples.log_z - 0.05 + 1e-5), errors)
    P, rng, h = 14 if moves else 7, np.random.default_rng(0), 1e-5

    def at(step: ndarray) -> PosesInCamera:
        once = np.where(np.arange(14) % 7 == 6, step / N_DEPTH_POSES, step)  # ``turned`` adds the frames' sizes up
        there = turned(of_object, once[:, :7])
        return with_hand(there, turned(hand, once[:, 7:])) if moves else there

    found = one(at(np.zeros((N_DEPTH_POSES, 14))), np.array([np.inf]))
    assert found.cross is not None
    H = found.cross[0].copy()
    for n in range(N_DEPTH_POSES):
        H[n, :, n] += found.H[0, n]
    for _ in range(5):
        step = np.zeros((N_DEPTH_POSES, 14))
        step[:, :P] = rng.normal(size=(N_DEPTH_POSES, P)) * np.tile([0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 1.0], 2)[:P]
        step[:, [6, 13]] = step[0, [6, 13]]
        ahead, here, behind = (one(at(k * h * step), np.array([np.inf])).value.sum() for k in (1.0, 0.0, -1.0))
        expected = np.einsum("np,npoq,oq->", step[:, :P], H, step[:, :P])
        assert (ahead - 2.0 * here + behind) / h**2 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("moves", [False, True], ids=["object", "both"])
def test_a_ray_that_misses_costs_as_much_as_its_sample_counts(moves: bool) -> None:
    """Those of the input hand cost nothing, wherever it is."""
    samples, of_object, hand = scene(2)
    samples = replace(samples, input=np.full_like(samples.input, np.nan))
    there, hand = (replace(body, centre=body.centre + np.array([2.0, 0.0, 0.0])) for body in (of_object, hand))
    poses = with_hand(there, hand) if moves else there
    on_object = np.arange(samples.weight.shape[1]) < samples.on_object[:, None]
    count = samples.weight.sum(where=True if moves else on_object)
    missed = DEPTH_TAIL_SIGMAS**2 * np.log1p((RAY_MISS_ERROR / (DEPTH_TAIL_SIGMAS * METRIC.noise)) ** 2)
    assert N_DEPTH_POSES * term(samples, METRIC).squared_deviations(poses)[0] == pytest.approx(missed * count)


@pytest.mark.parametrize("moves", [False, True], ids=["object", "both"])
def test_depth_without_samples_says_nothing(moves: bool) -> None:
    samples, of_object, hand = scene(2)
    none = replace(samples, weight=0.0 * samples.weight, on_object=0 * samples.used, used=0 * samples.used)
    there = with_hand(of_object, hand) if moves else of_object
    found = term(none, METRIC)(there, no_bound(there))
    for array in (found.value, found.g, found.H, found.cross):
        np.testing.assert_array_equal(array, 0.0)


def true_poses(seed: int) -> tuple[PosesInCamera, PosesInCamera]:
    R, centre = poses(np.random.default_rng(seed))
    hand = R @ se3.exp_so3(np.array([0.1, 0.2, 0.0])), centre + np.array([0.05, 0.03, -0.02])
    return PosesInCamera(R, centre, ONE), PosesInCamera(*hand, ONE)


def test_an_unknown_scale_hardly_costs_and_a_metric_one_does() -> None:
    samples, _, _ = scene(3, noise=0.0)
    exact = with_hand(*true_poses(3))

    def cost(errors: DepthErrors, factor: float) -> float:
        scaled = replace(samples, log_z=samples.log_z + np.log(factor))
        return float(term(scaled, errors)(exact, no_bound(exact)).value.sum())

    assert cost(FREE, 2.0) < 1.0 + cost(FREE, 1.0) + 30.0  # of a prior one wide
    assert cost(METRIC, 1.1) > 2.0 * cost(METRIC, 1.0)


def test_an_object_nearer_than_a_sensor_shows_it_costs_more_than_errors_that_last() -> None:
    """Of one deviation in each independent sample of 30 frames: else smooth errors that last draw it there."""
    samples, _, _ = scene(5, noise=0.0)
    of_object, _ = true_poses(5)
    farther = replace(samples, log_z=samples.log_z - 0.05 + 0.03)
    off = term(farther, depth_errors_of(DepthSource("metric", "sensor"))).squared_deviations(of_object)[0]
    assert N_DEPTH_POSES * off > 30 * N_INDEPENDENT_SAMPLES


def test_holes_say_nothing_and_other_samples_are_rejected_or_independent() -> None:
    samples, of_object, hand = scene(4)
    there = with_hand(of_object, hand)
    one = term(samples, FREE)
    without = replace(samples, weight=samples.weight * (np.arange(samples.weight.shape[1]) % 2))
    noise = np.random.default_rng(0).normal(size=samples.log_z.shape) * (without.weight == 0.0)
    np.testing.assert_allclose(
        term(without, FREE)(there, no_bound(there)).value,
        term(replace(without, log_z=without.log_z + noise), FREE)(there, no_bound(there)).value,
    )
    assert not one(there, np.array([-1.0])).g.any()


def test_two_hypotheses_are_as_each_alone() -> None:
    samples, of_object, _ = scene(5)
    other = turned(of_object, np.full((N_DEPTH_POSES, 7), 0.003))
    one = term(samples, METRIC)
    both = PosesInCamera(
        *(np.concatenate([a, b]) for a, b in zip(vars(of_object).values(), vars(other).values(), strict=True))
    )
    found = one(both, no_bound(both))
    for k, alone in enumerate((of_object, other)):
        np.testing.assert_allclose(found.value[k], one(alone, no_bound(alone)).value[0])
        np.testing.assert_allclose(found.g[k], one(alone, no_bound(alone)).g[0])


def test_wrong_depth_counts_little() -> None:
    samples, of_object, _ = scene(6)
    warped = replace(samples, log_z=samples.log_z + 0.01 * samples.place[..., 0])

    def pull(one: DepthTerm) -> float:
        found = one(of_object, no_bound(of_object))
        return float(np.abs(found.H[0]).max())

    assert pull(term(warped, METRIC)) < 0.5 * pull(term(samples, METRIC))
    assert (
        term(warped, METRIC).squared_deviations(of_object)[0]
        > 3.0 * term(samples, METRIC).squared_deviations(of_object)[0]
    )


def test_an_object_behind_the_camera_is_no_solution() -> None:
    samples, of_object, _ = scene(7)
    behind = replace(of_object, centre=-of_object.centre)
    assert np.isinf(term(samples, METRIC)(behind, no_bound(behind)).value).all()


def warped(samples: DepthSamples, by: float) -> DepthSamples:
    """Depth that is ``by`` farther at one corner of the image, and as much nearer at the other one."""
    return replace(
        samples,
        log_z=samples.log_z
        + by * (samples.modes[:, N_DEPTH_SCALE_ERRORS] + samples.modes[:, N_DEPTH_SCALE_ERRORS + 1]) / 2.0,
    )


@pytest.mark.parametrize("by", [-0.3, 0.03, 0.3])
def test_a_warp_costs_no_more_than_its_prior(by: float) -> None:
    samples, of_object, hand = scene(8)
    there = with_hand(of_object, hand)
    one, other = term(samples, METRIC), term(warped(samples, by), METRIC)
    prior = WARP_STUDENT_DOF * np.log1p(2.0 * (by / 2.0 / METRIC.warp) ** 2 / WARP_STUDENT_DOF)
    assert N_DEPTH_POSES * (other.squared_deviations(there) - one.squared_deviations(there))[0] < 1.2 * prior


def test_warped_depth_hardly_turns_the_hand_and_is_said() -> None:
    samples, _, _ = scene(9, noise=0.0)
    of_object, hand = true_poses(9)

    def turn(samples: DepthSamples, errors: DepthErrors) -> tuple[float, float]:
        """How far depth alone turns the hand from where it is, and its warp."""
        one = term(samples, errors)

        def there(w: ndarray) -> ObjectWithHand:
            step = np.zeros((N_DEPTH_POSES, 7))
            step[:, 3:6] = w
            return with_hand(of_object, turned(hand, step))

        found = minimize(lambda w: one(there(w), np.array([np.inf])).value.sum(), np.zeros(3), method="Powell").x
        return float(np.linalg.norm(found)), float(one.warp(there(found))[0])

    (_, none), (moved, warp) = turn(samples, METRIC), turn(warped(samples, 0.3), METRIC)
    stiff, _ = turn(warped(samples, 0.3), replace(METRIC, warp=1e-5))
    assert moved < 0.03
    assert moved < 0.2 * stiff
    assert none < 0.003
    assert warp > 0.03
