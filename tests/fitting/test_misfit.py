"""Laws of the misfit: about one for the object's own mesh, at any resolution; more for another; stiffer from there."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.clip import Masks
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.mask import MaskTerm, SilhouetteMesh, observe_masks
from getagrip.fitting.stages.mesh_deformation import relative_contour_error, stiffen_ridge
from getagrip.geometry import se3
from getagrip.geometry.kernels.silhouette import silhouettes, unpack
from getagrip.geometry.mesh import Mesh
from helpers.clips import box

FRAMES = 8
HELD = box(0.1, 0.06, 0.04)


def at_truth(pixels: int, fitted: Mesh = HELD) -> float:
    """The misfit of a mesh at the true poses of a box, in images of so many pixels."""
    rng = np.random.default_rng(0)
    R = se3.exp_so3(rng.normal(size=(FRAMES, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.02, 0.02, (FRAMES, 3))
    f, c = 1.4 * pixels, 0.5 * pixels
    t = SilhouetteMesh.of(HELD, np.zeros(3))
    bits = np.empty((FRAMES, pixels, -(-pixels // 64)), np.uint64)
    silhouettes(R, centre, np.ones(FRAMES), *t.tables, np.tile([f, f, c, c], (FRAMES, 1)), bits)
    seen = unpack(bits, pixels)
    K = np.tile([[f, 0.0, c], [0.0, f, c], [0.0, 0.0, 1.0]], (FRAMES, 1, 1))
    observation = observe_masks(Masks(seen, np.zeros_like(seen)), K)
    term = MaskTerm(SilhouetteMesh.of(fitted, np.zeros(3)), observation, level=64)
    poses = PosesInCamera(R[None], centre[None], np.ones(1))
    return relative_contour_error(observation, float(term(poses, np.full(1, np.inf)).value.mean()))


@pytest.mark.parametrize("pixels", [320, 640, 1280])
def test_the_objects_own_mesh_leaves_no_more_than_pixels_do(pixels: int) -> None:
    assert at_truth(pixels) < 1.2


def test_a_mesh_of_its_kind_leaves_more() -> None:
    wide = Mesh(HELD.vertices * [1.0, 1.2, 1.0], HELD.faces)
    wider = Mesh(HELD.vertices * [1.0, 1.4, 1.0], HELD.faces)
    assert 1.5 < at_truth(640, wide) < at_truth(640, wider)


def test_deviations_get_stiffer_where_masks_are_explained_worse() -> None:
    ridge = (1.5e6, 1e4)
    assert stiffen_ridge(ridge, 0.3) == stiffen_ridge(ridge, 1.0) == ridge
    once, twice = stiffen_ridge(ridge, 2.0), stiffen_ridge(ridge, 4.0)
    assert ridge < once < twice
    assert once[0] / once[1] == pytest.approx(ridge[0] / ridge[1])


def test_where_no_contour_is_seen_nothing_is_known() -> None:
    everything = np.ones((2, 40, 40), dtype=bool)
    K = np.tile([[50.0, 0.0, 20.0], [0.0, 50.0, 20.0], [0.0, 0.0, 1.0]], (2, 1, 1))
    assert relative_contour_error(observe_masks(Masks(everything, np.zeros_like(everything)), K), 100.0) == 1.0
