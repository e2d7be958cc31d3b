"""Reading MANO's pickles: from a fake of exactly the published layout, and from hostile ones."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.fit_joints import fit_joints
from getagrip.hands.model import PALM_REGIONS, PARENTS, HandModel, Side
from helpers.hand_files import fake_mano, python2


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep the user's cache folder out of the tests."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "getagrip"


@pytest.fixture
def right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, dict[str, Any]]:
    values = fake_mano(monkeypatch)
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(python2(values))
    return path, values


@pytest.mark.slow
def test_published_layout_is_read(right: tuple[Path, dict[str, Any]]) -> None:
    path, values = right
    hand = mano.load(path, "right")
    model = hand.model
    np.testing.assert_array_equal(model.template, values["v_template"])
    np.testing.assert_array_equal(model.shape_directions, values["shapedirs"].a.x[:, :, :10])
    np.testing.assert_allclose(model.joints, values["J"], atol=1e-15)
    np.testing.assert_array_equal(model.faces, values["f"])
    assert tuple(model.regions) == (*FINGERS, *PALM_REGIONS)


@pytest.mark.parametrize("side", ["right", "left"])
def test_regions_follow_from_skinning(side: Side) -> None:
    """What is done for MANO finds the generic hand's regions, which were placed by its bones."""
    hand = generic.load(side)
    regions = mano.mano_contact_regions(hand.template, hand.faces, hand.joints, hand.weights)
    assert tuple(regions) == (*FINGERS, *PALM_REGIONS)
    everything = np.concatenate(list(regions.values()))
    assert len(everything) == len(np.unique(everything))
    for finger in FINGERS:
        assert len(regions[finger]) >= 12
        assert np.isin(regions[finger], hand.regions[finger]).mean() > 0.9
    normals = hand.with_shape().with_pose().normals
    for name in PALM_REGIONS:
        assert np.isin(regions[name], hand.regions[name]).mean() > 0.5
        assert normals[regions[name], 1].mean() < -0.3


def smplx_vertices(values: dict[str, Any], betas: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The forward function of smplx's MANO layer, in plain loops (`lbs`, `batch_rigid_transform`)."""
    v = values["v_template"] + values["shapedirs"].a.x[:, :, :10] @ betas
    J = np.array([v[2 * j : 2 * j + 2].mean(axis=0) for j in range(16)])
    R = np.array([se3.exp_so3(w) for w in pose.reshape(15, 3)])
    v = v + values["posedirs"] @ (R - np.eye(3)).ravel()
    A = [se3.rigid(None, J[0])]
    for j in range(1, 16):
        A.append(A[PARENTS[j]] @ se3.rigid(R[j - 1], J[j] - J[PARENTS[j]]))
    moved = [se3.transform(T @ se3.rigid(None, -x), v) for T, x in zip(A, J, strict=True)]
    return np.einsum("vj,jvk->vk", values["weights"], np.array(moved))


@pytest.mark.slow
def test_vertices_are_those_of_the_usual_layer(right: tuple[Path, dict[str, Any]]) -> None:
    path, values = right
    rng = np.random.default_rng(1)
    betas, pose = rng.normal(size=10), rng.normal(scale=0.5, size=45)
    posed = mano.load(path, "right").model.with_shape(betas).with_pose(pose)
    np.testing.assert_allclose(posed.vertices, smplx_vertices(values, betas, pose), atol=1e-12)
    np.testing.assert_array_equal(posed.joints[4::4], posed.vertices[[745, 317, 444, 556, 673]])


@pytest.mark.slow
def test_left_shape_space_is_repaired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = fake_mano(monkeypatch, "left")
    path = tmp_path / "MANO_LEFT.pkl"
    path.write_bytes(python2(values))
    model = mano.load(path, "left").model
    published = values["shapedirs"].a.x[:, :, :10]
    np.testing.assert_array_equal(model.shape_directions, published * np.array([-1.0, 1.0, 1.0])[:, None])
    np.testing.assert_array_equal(mano.load(path, "left").model.shape_directions, model.shape_directions)  # from cache
    with pytest.raises(InputError, match=r"must be a right hand.*left hand"):
        mano.load(path, "right")


@pytest.mark.slow
def test_pose_encodings(right: tuple[Path, dict[str, Any]]) -> None:
    path, values = right
    hand = mano.load(path, "right")
    full, few = np.random.default_rng(2).normal(size=(3, 45)), np.random.default_rng(3).normal(size=(3, 15))
    mean, rows = values["hands_mean"], values["hands_components"]
    np.testing.assert_array_equal(hand.pose(full, "axis_angle", flat_hand_mean=True), full)
    np.testing.assert_allclose(hand.pose(full, "axis_angle", flat_hand_mean=False), full + mean)
    np.testing.assert_allclose(hand.pose(few, "pca", flat_hand_mean=True), few @ rows[:15])
    np.testing.assert_allclose(hand.pose(few, "pca", flat_hand_mean=False), few @ rows[:15] + mean)
    with pytest.raises(UsageError, match="got 15 as 'axis_angle'"):
        hand.pose(few, "axis_angle", flat_hand_mean=True)
    with pytest.raises(UsageError, match="got 48"):
        hand.pose(np.zeros(48), "pca", flat_hand_mean=True)


@pytest.mark.slow
def test_second_time_comes_from_the_cache(right: tuple[Path, dict[str, Any]], cache: Path) -> None:
    path, _ = right
    first = mano.load(path, "right")
    (stored,) = cache.glob("mano-*.npz")
    with np.load(stored, allow_pickle=False) as file:
        assert set(file) == set(mano.MANO_ARRAY_SHAPES)
    again = mano.load(path, "right")
    np.testing.assert_array_equal(first.model.shape_directions, again.model.shape_directions)
    stored.write_bytes(b"PK damaged")
    np.testing.assert_array_equal(mano.load(path, "right").model.template, first.model.template)


@pytest.mark.slow
def test_fits_like_any_hand(right: tuple[Path, dict[str, Any]]) -> None:
    model: HandModel = mano.load(right[0], "right").model
    pose = np.zeros((4, 15, 3))
    pose[:, :12, 2] = np.linspace(0.1, 0.5, 4)[:, None]
    posed = model.with_shape().with_pose(pose.reshape(4, 45))
    fit = fit_joints(model, posed.joints, "openpose")
    assert fit.residuals.mean() < 0.002


class Harm:
    """Unpickles by calling a function."""

    def __init__(self, function: Callable[..., Any], *args: Any) -> None:
        self.call = function, args

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


def hostile(marker: Path) -> dict[str, bytes]:
    touch = f"open({str(marker)!r}, 'w')"
    return {
        "system": pickle.dumps({"f": Harm(os.system, f"touch {marker}")}),
        "eval": pickle.dumps(Harm(eval, touch), protocol=2),
        "numpy": pickle.dumps({"f": Harm(np.load, str(marker))}),
        "codec": b"\x80\x02c_codecs\nencode\nX\x02\x00\x00\x00aaX\x03\x00\x00\x00zip\x86R.",
        "chumpy": b"cchumpy.ch\nsystem\n.",
        "getattr": b"c__builtin__\ngetattr\n.",
        "dotted": b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.",
    }


@pytest.mark.parametrize("kind", ["system", "eval", "numpy", "codec", "chumpy", "getattr", "dotted"])
def test_hostile_pickles_are_refused_and_run_nothing(tmp_path: Path, kind: str, cache: Path) -> None:
    path, marker = tmp_path / "MANO_RIGHT.pkl", tmp_path / "ran"
    path.write_bytes(hostile(marker)[kind])
    with pytest.raises(InputError, match="nothing in it was run"):
        mano.load(path, "right")
    assert not marker.exists()
    assert not cache.exists()


def without_state(kind: str) -> bytes:
    return b"}X\x01\x00\x00\x00f" + f"c{kind}\n)\x81s.".encode()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a pickle",
        pickle.dumps([1, 2]),
        python2(np.zeros(3)),
        without_state("chumpy.ch\nCh"),
        without_state("scipy.sparse.csc\ncsc_matrix"),
        without_state("numpy\nndarray"),
    ],
)
def test_damaged_pickles_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(content)
    with pytest.raises(InputError, match="must be a"):
        mano.load(path, "right")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("weights", None, "missing weights"),
        ("weights", np.eye(1, 16) * np.ones((778, 1)), "no vertex in the region thumb"),
        ("weights", np.zeros((778, 15)), r"got shape \(778, 15\)"),
        ("posedirs", np.full((778, 3, 135), np.nan), "got NaN"),
        ("f", np.full((1538, 3), 778), "got vertex 778"),
        ("hands_mean", "text", "got str"),
        ("kintree_table", np.zeros((2, 16), dtype=int), "kintree_table"),
    ],
)
@pytest.mark.slow
def test_wrong_arrays_are_named(right: tuple[Path, dict[str, Any]], key: str, value: Any, message: str) -> None:
    path, values = right
    path.write_bytes(python2({k: v for k, v in {**values, key: value}.items() if v is not None}))
    with pytest.raises(InputError, match=message):
        mano.load(path, "right")


def test_sparse_indices_outside_the_matrix_are_refused(right: tuple[Path, dict[str, Any]]) -> None:
    path, values = right
    values["J_regressor"].indices[0] = 99
    path.write_bytes(python2(values))
    with pytest.raises(InputError, match="does not load"):
        mano.load(path, "right")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        mano.load(tmp_path / "MANO_RIGHT.pkl", "right")
