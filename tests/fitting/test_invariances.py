"""What does not matter to reconstructions of small clips: frames, mirrors, pixels, seeds, threads, and the CPU."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 - brings a BLAS of its own
from numpy import ndarray
from threadpoolctl import threadpool_info

from getagrip.clip import Clip, Masks, read_clip, write_clip
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from helpers.environment import import_path
from helpers.scenes import DEFAULT, SHORT, SMALL, found, scene

SHIFTED = se3.rigid(None, np.array([0.1, -0.2, 0.05]))


def posed(result: Reconstruction, mesh: Mesh) -> ndarray:
    """Vertices (T, V, 3) in the hand frame."""
    return se3.transform(result.T_hand_obj, result.scale * mesh.vertices)


def apart(a: ndarray, b: ndarray) -> float:
    """Mean distance of corresponding vertices [m]."""
    return float(np.linalg.norm(a - b, axis=-1).mean())


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result_to_the_bit() -> None:
    a, b = found("spoon", 1), reconstruct(*scene("spoon", 1), DEFAULT)
    np.testing.assert_array_equal(a.T_hand_obj, b.T_hand_obj)
    np.testing.assert_array_equal(a.candidates.energy, b.candidates.energy)
    assert a.energy == b.energy


@pytest.mark.slow
def test_threads_share_the_work_and_find_the_same_to_the_bit() -> None:
    options = Options(inits=5)  # not to be shared out evenly
    one, more = (reconstruct(*scene("spoon", 1, SHORT), options, threads=threads) for threads in (1, 3))
    np.testing.assert_array_equal(one.candidates.T_hand_obj, more.candidates.T_hand_obj)
    np.testing.assert_array_equal(one.candidates.energy, more.candidates.energy)
    assert (one.energy, one.status, one.options) == (more.energy, more.status, more.options)


@pytest.mark.slow
def test_another_seed_finds_the_same() -> None:
    a, b = found("kettle", 1), reconstruct(*scene("kettle", 1), replace(DEFAULT, seed=1))
    mesh = scene("kettle", 1)[0].mesh
    assert 0.0 < apart(posed(a, mesh), posed(b, mesh)) < 0.02 * mesh.diameter


def _reframed(clip: Clip, T_new_old: ndarray) -> Clip:
    """The same object, its CAD drawn in another frame."""
    return replace(clip, mesh=Mesh(se3.transform(T_new_old, clip.mesh.vertices), clip.mesh.faces), truth=None)


@pytest.mark.parametrize(
    ("T", "tolerance"),
    [(SHIFTED, 2e-3), (se3.rigid(se3.exp_so3(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3)), 0.02)],
    ids=["shifted", "turned"],
)
@pytest.mark.slow
def test_the_frame_of_the_cad_does_not_matter(T: ndarray, tolerance: float) -> None:
    """Turned, the search starts from other poses of the object, and ends where it did."""
    clip, masks = scene("kettle", 1)
    other = _reframed(clip, T)
    a, b = found("kettle", 1), reconstruct(other, masks, DEFAULT)
    assert apart(posed(a, clip.mesh), posed(b, other.mesh)) < tolerance * clip.mesh.diameter


@pytest.mark.slow
def test_the_origin_of_the_cad_does_not_matter_at_a_free_size() -> None:
    clip, masks = scene("kettle", 1)
    free = replace(clip, scale="free", truth=None)
    other = _reframed(free, SHIFTED)
    a, b = reconstruct(free, masks, DEFAULT), reconstruct(other, masks, DEFAULT)
    assert a.scale != 1.0
    assert apart(posed(a, clip.mesh), posed(b, other.mesh)) < 2e-3 * clip.mesh.diameter


@pytest.mark.parametrize("lie", ["half", "elsewhere", "everything"])
@pytest.mark.slow
def test_one_wrong_mask_of_eight_hardly_matters(lie: str) -> None:
    """Half of the object, another place, the hand's pixels too: the other frames stay where they are."""
    clip, masks = scene("kettle", 1)
    wrong, n = masks.object.copy(), 3
    rows = np.flatnonzero(wrong[n].any(axis=1))
    if lie == "half":
        wrong[n, : int(rows.mean())] = False
    elif lie == "elsewhere":
        wrong[n] = np.roll(wrong[n], len(rows), axis=0)
    else:
        wrong[n] |= masks.ignore[n]
    a, b = found("kettle", 1), reconstruct(clip, Masks(wrong, masks.ignore & ~wrong), DEFAULT)
    others = np.arange(len(clip)) != n
    off = apart(posed(a, clip.mesh)[others], posed(b, clip.mesh)[others])
    assert off < 0.05 * clip.mesh.diameter


@pytest.mark.slow
def test_turning_the_camera_about_its_axis_does_not_matter() -> None:
    """A quarter turn: pixel (u, v) of a picture of width W becomes (v, W - u)."""
    clip, masks = scene("kettle", 1)
    width, height = clip.size
    (fx, fy), (cx, cy) = clip.K[0, [0, 1], [0, 1]], clip.K[0, :2, 2]
    K = np.tile([[fy, 0.0, cy], [0.0, fx, width - cx], [0.0, 0.0, 1.0]], (len(clip), 1, 1))
    turn = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    hand = replace(clip.hand, T_cam_hand=turn @ clip.hand.T_cam_hand)
    turned = replace(clip, K=K, size=(height, width), hand=hand, truth=None)
    quarter = Masks(*(np.ascontiguousarray(np.rot90(m, axes=(1, 2))) for m in (masks.object, masks.ignore)))
    a, b = found("kettle", 1), reconstruct(turned, quarter, DEFAULT)
    assert apart(posed(a, clip.mesh), posed(b, clip.mesh)) < 0.02 * clip.mesh.diameter


@pytest.mark.slow
def test_a_left_hand_is_a_right_hand_in_a_mirror() -> None:
    left = replace(SMALL, side="left")
    a, b = found("kettle", 1), found("kettle", 1, left)
    mesh, mirrored = scene("kettle", 1)[0].mesh, scene("kettle", 1, left)[0].mesh
    assert apart(posed(a, mesh), posed(b, mirrored) * [-1.0, 1.0, 1.0]) < 0.02 * mesh.diameter


@pytest.mark.slow
def test_the_size_of_the_pixels_does_not_matter() -> None:
    """Masks of twice the resolution give the same object."""
    clip, masks = scene("kettle", 1)
    double = np.diag([2.0, 2.0, 1.0])
    width, height = clip.size
    finer = replace(clip, K=double @ clip.K, size=(2 * width, 2 * height), truth=None)
    grown = Masks(*(m.repeat(2, axis=1).repeat(2, axis=2) for m in (masks.object, masks.ignore)))
    a, b = found("kettle", 1), reconstruct(finer, grown, DEFAULT)
    assert apart(posed(a, clip.mesh), posed(b, clip.mesh)) < 0.01 * clip.mesh.diameter


KERNELS = {one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}
OTHER = "Prescott" if "Nehalem" in KERNELS else "Nehalem"
"""What every x86-64 can compute with, and this process does not."""
CHILD = """
import json
import sys
from threadpoolctl import threadpool_info
from getagrip.clip import read_clip
from getagrip.reconstruct import reconstruct

result = reconstruct(read_clip(sys.argv[1]))
kernels = [one.get("architecture") for one in threadpool_info()]
print(json.dumps([result.T_hand_obj.tolist(), result.energy["total"], kernels]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not KERNELS, reason="needs OpenBLAS, whose kernels can be chosen")
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason=f"OpenBLAS's {OTHER} is an x86-64")
def test_where_blas_adds_up_in_another_order_poses_stay_within_the_tolerance(tmp_path: Path) -> None:
    folder = write_clip(*scene("pan", 0, SHORT), tmp_path / "pan")
    here = reconstruct(read_clip(folder))
    env = import_path() | {"OPENBLAS_CORETYPE": OTHER}
    child = subprocess.run([sys.executable, "-c", CHILD, folder], env=env, stdout=subprocess.PIPE, check=True)
    there, energy, kernels = json.loads(child.stdout)
    if KERNELS & {*kernels}:
        pytest.skip("this OpenBLAS has the kernels of one CPU only")
    T = np.array(there)
    assert not np.array_equal(T, here.T_hand_obj)
    assert 1e3 * np.linalg.norm((T - here.T_hand_obj)[:, :3, 3], axis=1).max() < 0.01  # mm
    assert np.degrees(se3.angle_between(T[:, :3, :3], here.T_hand_obj[:, :3, :3])).max() < 0.01
    assert energy == pytest.approx(here.energy["total"], rel=1e-6)
