"""Signs of whether a grasp of a timeline is right (``checks.signs``), as of a grasp by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from getagrip.checks.signs import read_signs
from getagrip.checks.solved import Solved
from getagrip.fitting.every_frame import at_sampled_frames
from getagrip.fitting.methods.all_frames import soft_energy
from getagrip.fitting.misfit import misfit
from getagrip.fitting.motion import placed
from getagrip.fitting.pose_spread import pose_spread
from getagrip.fitting.scale_check import scale_check
from getagrip.fitting.search import suppress_duplicates
from getagrip.fitting.solve import in_camera
from getagrip.result import Candidates
from getagrip.timelines.footage import Footage
from getagrip.timelines.grasp_segment import FINEST, GraspTrack

CANDIDATES = 4
"""Solutions that count, the chosen one included: as many as a search by itself ends with."""


def signs_of(footage: Footage, track: GraspTrack) -> Mapping[str, float]:
    """The signs of a grasp, at the frames that were fitted together; solutions' energies are without links."""
    grasp, found = track.grasp, track.found
    problem, poses = grasp.problem, grasp.motion.poses()
    energy = grasp.energy.copy()
    energy[track.chosen] = min(0.0, float(energy.min())) - 1.0
    best = suppress_duplicates(poses, energy, problem.surface, CANDIDATES)
    sampled = at_sampled_frames(problem, found)
    T_hand_obj = placed(poses.take(best), problem.clip.mesh.centre)
    T_hand_obj[0] = sampled.T_hand_obj[0]
    mask, *_ = soft_energy(problem)(FINEST, np.arange(len(problem.clip)))
    assert found.motion is not None
    missed = float(mask(in_camera(found.motion, problem.clip.hand.T_cam_hand), np.full(1, np.inf)).value.sum())
    entry = footage.grasp_clip(grasp.segment)
    assert entry is not None
    own = entry[0].take(entry[0].index_of(problem.clip.frames))
    return read_signs(
        Solved(
            problem.clip,
            problem.input_masks,
            sampled.T_hand_obj[0],
            1.0,
            sampled.iou,
            candidates=Candidates(T_hand_obj, poses.scale[best], grasp.energy[best]),
            axis=found.axis,
            T_cam_hand_input=own.hand.T_cam_hand,
            spread=pose_spread(problem, replace(found, terms=found.terms | {"mask": missed})),
            misfit=misfit(problem.observation, missed / len(problem.clip)),
            deformed=0.0,
            scale_check=scale_check(problem, found),
        )
    )
