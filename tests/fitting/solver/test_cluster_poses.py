"""Clusters of rotations, and initial poses learnt from grasps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.solver import cluster_poses as clusters
from getagrip.fitting.solver.cluster_poses import cluster_rotations, karcher_mean, learn_pose_priors, true_grasp_pose
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from helpers.measures import held, rotations

SEEDS = st.integers(0, 2**32 - 1)


def near(R: ndarray, n: int, degrees: float, seed: int = 0) -> ndarray:
    """n rotations about so far from R."""
    return se3.exp_so3(np.radians(degrees) * np.random.default_rng(seed).normal(size=(n, 3)) / np.sqrt(3.0)) @ R


@pytest.mark.parametrize("way", ["geodesic", "axis-angle"])
def test_planted_clusters_are_found_the_fullest_first(way: clusters.Way) -> None:
    centres = se3.exp_so3(np.array([[0.5, 0.0, 0.0], [0.0, -1.5, 0.0], [0.3, 0.4, 2.0]]))
    R = np.concatenate([near(R, n, 4.0, n) for R, n in zip(centres, (20, 9, 14), strict=True)])
    found = cluster_rotations(R, 3, way)
    assert np.degrees(se3.angle_between(found, centres[[0, 2, 1]])).max() < 4.0


@given(SEEDS)
@pytest.mark.slow
def test_clusters_on_so3_turn_with_what_they_are_made_of(seed: int) -> None:
    R, (hand, cad) = rotations(20, seed), rotations(2, seed + 1)
    assert np.allclose(cluster_rotations(hand @ R @ cad, 5), hand @ cluster_rotations(R, 5) @ cad, atol=1e-6)


def test_half_turns_about_opposite_directions_are_one_cluster_but_for_rotation_vectors() -> None:
    R = se3.exp_so3(np.array([[0.0, 0.0, np.pi - 0.01], [0.0, 0.0, -np.pi + 0.01]]))
    assert np.degrees(se3.angle_between(cluster_rotations(R, 1), R)).max() < 1.0
    assert np.degrees(se3.angle_between(cluster_rotations(R, 1, "axis-angle"), R)).min() > 170.0


@given(SEEDS, st.integers(1, 12), st.integers(1, 12))
@pytest.mark.slow
def test_no_more_clusters_than_asked_for_or_than_there_are_rotations(seed: int, n: int, k: int) -> None:
    R = rotations(n, seed)
    twice = np.concatenate([R, R])
    assert len(cluster_rotations(twice, k)) <= min(n, k)
    alike = cluster_rotations(twice, 2 * n)
    assert len(alike) == n
    assert se3.angle_between(R[:, None], alike[None]).min(axis=1).max() < 1e-6


@given(SEEDS)
@pytest.mark.slow
def test_the_mean_rotation_has_the_least_mean_squared_angle(seed: int) -> None:
    R = near(rotations(1, seed)[0], 7, 40.0, seed)
    mean = karcher_mean(R)

    def spread(M: ndarray) -> float:
        return float(np.sum(se3.angle_between(M, R) ** 2))

    assert all(spread(mean) <= spread(near(mean, 1, 3.0, k)[0]) for k in range(10))
    assert np.allclose(karcher_mean(R[:2]), R[0] @ se3.exp_so3(se3.log_so3(R[0].T @ R[1]) / 2.0), atol=1e-7)


@given(SEEDS)
@pytest.mark.slow
def test_a_learnt_object_is_at_the_mean_place_of_the_grasps_wherever_its_cad_has_its_origin(seed: int) -> None:
    clips = [held("a", seed=1), held("b", seed=2)]
    shift = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    centres = []
    for moved in (np.zeros(3), shift):
        there = []
        for clip in clips:
            assert clip.truth is not None
            truth = replace(clip.truth, T_cam_obj=clip.truth.T_cam_obj @ se3.rigid(t=-moved))
            there.append(
                true_grasp_pose(replace(clip, mesh=Mesh(clip.mesh.vertices + moved, clip.mesh.faces), truth=truth))
            )
        learnt = learn_pose_priors(there, k=2)
        centres.append(se3.transform(learnt.T_hand_obj, (clips[0].mesh.centre + moved)[None])[:, 0])
    assert np.allclose(centres[0], centres[1])
    assert np.allclose(centres[0], [0.015, 0.02, -0.03])


def test_categories_and_sides_are_learnt_apart() -> None:
    clips = [held("a"), held("b", seed=1, category="mug"), replace(held("c", seed=2), side="left")]
    learnt = learn_pose_priors([true_grasp_pose(clip) for clip in clips], k=5)
    assert [len(learnt.of(*key)) for key in (("box", "right"), ("box", "left"), ("mug", "right"))] == [1, 1, 1]
    assert not len(learnt.of("mug", "left"))
    assert np.allclose(learnt.of("mug", "right")[0, :3, :3], rotations(1, 1)[0])
