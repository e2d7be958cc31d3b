"""Grasps to learn initial poses from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.fitting.options import Options, PriorsFile
from getagrip.fitting.solver import initial_poses as priors
from getagrip.fitting.solver.cluster_poses import learn_pose_priors, true_grasp_pose
from getagrip.geometry import se3
from helpers.clips import small_clip


def rotations(n: int, seed: int = 0) -> ndarray:
    return se3.from_quaternion(np.random.default_rng(seed).normal(size=(n, 4)))


def held(name: str, subject: str = "", seed: int = 0, category: str = "box") -> Clip:
    """A clip of somebody's, in which the object is held still in some way."""
    clip = small_clip()[0]
    T_hand_obj = se3.rigid(rotations(1, seed)[0], np.array([0.01 * seed, 0.02, -0.03]))
    assert clip.truth is not None
    truth = replace(clip.truth, T_cam_obj=clip.truth.T_cam_hand @ T_hand_obj)
    return replace(clip, name=name, category=category, truth=truth, provenance={"subject": subject} if subject else {})


def old_file(path: Path, *clips: Clip) -> Options:
    """Options with a file of the first version, which holds poses learnt from some clips."""
    learnt = learn_pose_priors([true_grasp_pose(clip) for clip in clips], k=10)
    names = {name: np.array(getattr(learnt, name), np.str_) for name in priors.PRIOR_NAME_KEYS}
    np.savez(path, version=np.array(1), T_hand_obj=learnt.T_hand_obj, **names)  # type: ignore[arg-type]
    return Options(init="clusters", priors=PriorsFile(path), inits=12)
