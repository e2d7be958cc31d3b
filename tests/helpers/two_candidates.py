"""A small clip with ground truth, and a result of it that has a right and a wrong candidate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3
from getagrip.report.pictures.result_view import View
from getagrip.result import Candidates, Reconstruction
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import scene_with_axis
from helpers.true_result import true_result

SMALL = SceneOptions(frames=5, size=(160, 120), focal=150.0)
OFF = 0.03
"""The wrong candidate is so far off [m]."""


@cache
def two_candidates() -> tuple[Reconstruction, Clip, Masks]:
    """The ground truth, and the same moved by ``OFF`` and turned, at a higher energy."""
    clip, masks, axis = scene_with_axis("mug", 0, SMALL)
    true = true_result(clip, axis)
    wrong = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 0.8])), np.array([OFF, 0.0, 0.0])) @ true.T_hand_obj
    poses = np.stack([true.T_hand_obj, wrong])
    candidates = Candidates(poses, np.full(2, true.scale), np.array([100.0, 150.0]))
    return replace(true, candidates=candidates), clip, masks


def view() -> View:
    """The same as pictures show it."""
    return View.of(*two_candidates())
