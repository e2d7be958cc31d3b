"""Hands from clicked joints: known hands are recovered, wrong clicks reported, motion is smooth in between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import Chains, PosePrior, joints_and_jacobian
from getagrip.hands.from_2d.clicks import MIN_CLICKED_JOINTS, ClickedHands, hands_from_clicks
from getagrip.hands.from_2d.rigid_pnp import Clicks, click_equations, project_hand_joints
from getagrip.hands.model import Side

K = np.array([[1500.0, 0.0, 960.0], [0.0, 1500.0, 540.0], [0.0, 0.0, 1.0]])
KEYS = (0, 8, 20, 31, 40)


class Held(NamedTuple):
    """Hands that hold something, on the frames ``KEYS``."""

    T: np.ndarray
    X: np.ndarray
    """Joints before the camera [m]."""
    uv: np.ndarray


def held(side: Side, seed: int) -> Held:
    rng = np.random.default_rng(seed)
    model = generic.load(side)
    prior = PosePrior.of(model)
    grasp = prior.mean + np.einsum("fka,fkab->fkb", rng.normal(scale=0.4 * prior.spread), prior.axes)
    grasp[1:] += rng.uniform(0.0, 0.6) * prior.axes[1:, :, 1]
    q = grasp + rng.normal(scale=0.03, size=(len(KEYS), 5, 3, 3))
    R = se3.exp_so3(rng.normal(scale=0.25, size=(len(KEYS), 3))) @ se3.exp_so3(rng.normal(scale=1.2, size=3))
    t = np.column_stack([rng.normal(0.0, 0.05, (len(KEYS), 2)), rng.uniform(0.4, 0.6, len(KEYS))])
    T = se3.rigid(R, t)
    X, _ = joints_and_jacobian(Chains.of(model), q, np.zeros(len(model.shape_names)))
    X = se3.transform(T, X)
    return Held(T, X, project(K, X))


def clicked(truth: Held, seed: int, noise: float = 2.0, missing: int = 6) -> dict[int, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = truth.uv + rng.normal(scale=noise, size=truth.uv.shape)
    for row in points:
        row[rng.choice(21, missing, replace=False)] = np.nan
    return dict(zip(KEYS, points, strict=True))


def joints_of(found: ClickedHands, rows: tuple[int, ...] = KEYS) -> np.ndarray:
    assert found.hand.joints is not None
    return se3.transform(found.hand.T_cam_hand[list(rows)], found.hand.joints[list(rows)])


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_known_hands_are_found_again(side: Side, seed: int) -> None:
    truth = held(side, seed)
    found = hands_from_clicks(clicked(truth, seed), K, side, 0, 40)
    X = joints_of(found)
    off = np.linalg.norm(project(K, X) - truth.uv, axis=-1)
    assert np.median(off) < 3.0  # of clicks that are 2.5 px off in the median, a third of the joints not clicked
    angles = se3.angle_between(found.hand.T_cam_hand[list(KEYS)][:, :3, :3], truth.T[:, :3, :3])
    assert np.degrees(angles).max() < 10.0
    assert np.abs(X[..., 2] / truth.X[..., 2] - 1.0).max() < 0.08
    assert not found.outliers.any()
    assert np.array_equal(np.isnan(found.residuals), np.isnan(list(clicked(truth, seed).values())).any(axis=-1))


@pytest.mark.slow
def test_a_few_wrong_clicks_are_reported_and_do_little_harm() -> None:
    truth = held("right", 5)
    clicks = clicked(truth, 5, missing=2)
    wrong = [(8, 8), (31, 16)]
    for frame, joint in wrong:
        clicks[frame][joint] = truth.uv[KEYS.index(frame), joint] + [90.0, -70.0]
    found = hands_from_clicks(clicks, K, "right", 0, 40)
    flagged = {(KEYS[k], int(joint)) for k, joint in zip(*np.nonzero(found.outliers), strict=True)}
    assert flagged == set(wrong)
    assert np.median(np.linalg.norm(project(K, joints_of(found)) - truth.uv, axis=-1)) < 3.0


@pytest.mark.slow
def test_the_mirrored_image_is_of_the_mirrored_hand() -> None:
    """Both sides' starts differ, hence the tolerance."""
    clicks = clicked(held("left", 6), 6, noise=0.0, missing=3)
    mirrored = {n: points * [-1.0, 1.0] + [2.0 * K[0, 2], 0.0] for n, points in clicks.items()}
    one = joints_of(hands_from_clicks(clicks, K, "left", 0, 40))
    other = joints_of(hands_from_clicks(mirrored, K, "right", 0, 40))
    np.testing.assert_allclose(other * [-1.0, 1.0, 1.0], one, atol=2e-3)


@pytest.mark.slow
def test_size_is_the_generic_hands_whatever_the_focal_length() -> None:
    """What one view does not determine stays a guess."""
    truth = held("right", 7)
    clicks = clicked(truth, 7)
    for zoom in (0.6, 1.0, 1.6):
        found = hands_from_clicks(clicks, np.diag([zoom, zoom, 1.0]) @ K, "right", 0, 40)
        assert np.abs(found.shape).max() < 0.25


@pytest.mark.slow
def test_hands_move_smoothly_between_keys_and_rest_beyond_them() -> None:
    truth = held("left", 8)
    clicks = {n + 10: points for n, points in clicked(truth, 8).items()}
    found = hands_from_clicks(clicks, K, "left", 5, 60)
    alone = hands_from_clicks(clicks, K, "left", 10, 50)
    T = found.hand.T_cam_hand
    assert len(T) == 56
    np.testing.assert_allclose(T[5:46], alone.hand.T_cam_hand)
    np.testing.assert_allclose(T[:5], np.broadcast_to(T[5], (5, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(T[46:], np.broadcast_to(T[45], (10, 4, 4)), atol=1e-12)
    steps = np.linalg.norm(np.diff(T[5:46, :3, 3], axis=0), axis=1)
    assert np.abs(np.diff(steps)).max() < 0.5 * steps.max()
    assert se3.is_rigid(T).all()


def test_one_frame_will_do() -> None:
    truth = held("right", 9)
    found = hands_from_clicks({20: truth.uv[2]}, K, "right", 18, 22)
    assert np.nanmedian(found.residuals) < 4.0
    assert np.ptp(found.hand.T_cam_hand, axis=0).max() < 1e-12


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_points_without_sense_give_a_hand_before_the_camera_or_are_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clicks = {n: rng.normal([900.0, 500.0], [30.0, 150.0, 1500.0][seed], (21, 2)) for n in (2, 9)}
    try:
        found = hands_from_clicks(clicks, K, "left", 0, 10)
    except UsageError as error:
        assert "no hand looks like that" in str(error)  # noqa: PT017
    else:
        assert se3.is_rigid(found.hand.T_cam_hand).all()
        assert (found.hand.T_cam_hand[:, 2, 3] > 0.0).all()


def test_what_cannot_be_fitted_is_refused() -> None:
    few = np.full((21, 2), np.nan)
    few[: MIN_CLICKED_JOINTS - 1] = 100.0
    for clicks, words in (
        ({}, "missing joints"),
        ({50: held("right", 0).uv[0]}, "frame 50"),
        ({3: few}, f"got {MIN_CLICKED_JOINTS - 1}"),
        ({3: np.full((21, 2), np.inf)}, "finite"),
        ({3: np.zeros((20, 2))}, r"\(21, 2\)"),
        ({3: np.full((21, 2), 100.0) + np.arange(42).reshape(21, 2) % 5}, "within 4 px"),
    ):
        with pytest.raises(UsageError, match=words):
            hands_from_clicks(clicks, K, "right", 0, 40)


def test_depths_of_a_turned_hand_bend_the_same_fingers() -> None:
    """A plane over the image, added to the depths of joints, changes neither cost nor gradient."""
    truth, rng = held("right", 2), np.random.default_rng(2)
    model = generic.load("right")
    q = np.tile(np.eye(3), (len(KEYS), 5, 1, 1))
    X, J = joints_and_jacobian(Chains.of(model), q, np.zeros(len(model.shape_names)))
    uv = project_hand_joints(K, truth.T, X, J)[0]
    clicks = Clicks.of(K, uv)._replace(depth_known=np.ones(len(KEYS), dtype=bool))
    bent = rng.normal(scale=0.01, size=(len(KEYS), 21))
    turned = bent + (uv - uv.mean(axis=1, keepdims=True)) @ [3e-4, -2e-4] + 0.1
    assert np.ptp(turned - bent, axis=1).min() > 0.02
    plain, same, none = (
        click_equations(clicks._replace(depth=depth), truth.T, X, J) for depth in (bent, turned, 0.0 * bent)
    )
    assert (np.abs(none[0] - plain[0]) > 0.1 * plain[0]).any()
    for a, b in zip(plain, same, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-2, atol=1e-2 * np.abs(a).max())
