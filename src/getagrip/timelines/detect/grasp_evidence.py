"""Fits of the object to the hand: while a hand moves the object, one motion in the hand explains the masks.

Each fit is searched in some frames and then extended, with its shared parameters fixed, to the frames around them. Its
misfit to the masks in these, and its deviations from its own motion, show whether the same grasp began earlier or ended
later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks, with_masks
from getagrip.clip.timeline import Side
from getagrip.errors import GetagripError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.motion import hand_object_transforms
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solver.solve import poses_in_camera
from getagrip.fitting.stages.mesh_deformation import CROP_CONTOUR_ERROR_PX, IMAGE_CONTOUR_ERROR_PX
from getagrip.fitting.stages.remaining_frames import fit_frame_parameters

HINGE_FIT_METHOD = "soft-hinge"
TRIAL_BATCH_FRAMES = 30
"""Number of frames to which a fit is extended at once."""


class NothingToFitError(GetagripError):
    """Frames in which the object cannot be fitted: its masks are empty, or it cannot be rendered."""


@dataclass(frozen=True)
class HingeFit:
    """A motion of the object in one hand, fitted in some frames and extended to more.

    Attributes:
        frames: (n,) frames of the fit and of its extension, ascending.
        T_cam_obj: (n, 4, 4) poses of the object.
        T_cam_hand: (n, 4, 4) poses of the hand.
        misfit: (n,) mean distance of contours to the mask's, deviations from the fit's motion included [image px]; NaN
            where no mask shows the object.
        expected: (n,) misfit of a right fit to perfect masks (``fitting.stages.mesh_deformation``) [image px].
        scale: scale of the object.
        side: side of the hand.
    """

    frames: Int[ndarray, "n"]
    T_cam_obj: Float[ndarray, "n 4 4"]
    T_cam_hand: Float[ndarray, "n 4 4"]
    misfit: Float[ndarray, "n"]
    expected: Float[ndarray, "n"]
    scale: float
    side: Side


def fit_hinge(
    clip: Clip, masks: Masks, frames: Int[ndarray, "n"], around: Int[ndarray, "m"], options: Options
) -> HingeFit:
    """Fit the object in ``frames``, and extend the best fit to the frames ``around``, which include them.

    Raises ``NothingToFitError`` where fewer than two masks show the object or it cannot be rendered, and ``InputError``
    for initial poses as ``prepare_problem`` does.
    """
    observed = masks.observed
    if observed[frames].sum() < 2:
        raise NothingToFitError("fewer than two masks show the object")
    clip = with_masks(clip, masks)
    problem = prepare_problem(clip.take(frames), options)
    try:
        found = METHODS[HINGE_FIT_METHOD].fit(problem, lambda _: None)
    except GetagripError as error:
        raise NothingToFitError(str(error)) from error
    assert found.motion is not None
    found = replace(found, motion=found.motion.take(np.zeros(1, int)))
    problem = problem.as_found(found)
    part = problem.with_hand_found(clip.take(around))
    sampled = part.index_of(problem.clip.frames)
    n = len(around)
    T_hand_obj, misfit, expected = np.tile(np.eye(4), (n, 1, 1)), np.full(n, np.nan), np.full(n, IMAGE_CONTOUR_ERROR_PX)
    seen = np.flatnonzero(observed[around])
    for index in np.array_split(seen, -(-len(seen) // TRIAL_BATCH_FRAMES)):
        at = problem.at(part.take(index))
        T_hand_obj[index], misfit[index] = _evaluate_fit(at, found, sampled, index)
        expected[index] = IMAGE_CONTOUR_ERROR_PX + CROP_CONTOUR_ERROR_PX / at.observation.crops.zoom
    for t in np.setdiff1d(np.arange(n), seen):
        T_hand_obj[t] = T_hand_obj[seen[np.argmin(np.abs(seen - t))]]
    T_cam_hand = part.hand.T_cam_hand
    scale = float(found.poses.scale[0])
    return HingeFit(around, T_cam_hand @ T_hand_obj, T_cam_hand, misfit, expected, scale, clip.side)


def _evaluate_fit(
    problem: Problem, found: MethodResult, sampled: Int[ndarray, "n"], index: Int[ndarray, "m"]
) -> tuple[Float[ndarray, "m 4 4"], Float[ndarray, "m"]]:
    """Evaluate a fit in the problem's frames: poses in the hand, and misfit to the masks [image px]."""
    motion = fit_frame_parameters(problem, found, sampled, index)
    assert found.energy_of is not None
    mask = next(term for term in found.energy_of(problem)(256, np.arange(len(index))) if term.name == "mask")
    energy = mask(poses_in_camera(motion, problem.clip.hand.T_cam_hand), np.full(1, np.inf)).value[0]
    here = np.arange(len(index))
    energy = energy + [motion.resampled(here, here[t : t + 1]).prior().value[0] for t in here]
    observation = problem.observation
    length = observation.targets[..., 4].sum(axis=1)
    misfit = np.divide(energy, length * observation.crops.zoom, out=np.full(len(index), np.nan), where=length > 0.0)
    return hand_object_transforms(motion.poses(), problem.clip.mesh.centre)[0], misfit


def split_runs(runs: Sequence[tuple[int, int]], longest: int, shortest: int) -> Iterator[Int[ndarray, "n"]]:
    """Yield the frames of runs in parts of at most ``longest`` frames; runs shorter than ``shortest`` are skipped."""
    for first, last in runs:
        n = last + 1 - first
        if n >= shortest:
            yield from np.array_split(np.arange(first, last + 1), -(-n // longest))
