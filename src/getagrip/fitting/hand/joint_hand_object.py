"""Hand and object solved together, by all evidence on either and by the contact between them.

The hand was refined by its own evidence before (``refine_hand``). Here the same errors, under the same prior, are
parameters beside the object's motion (``MovingHand``). So evidence on the object tells about the hand, above all its
distance: the hand's own silhouette says little about it, the object's much, and the two touch.

The sizes of hand and object: one camera sees both, and a scene twice as large and twice as far away looks the same.

A hand that was lifted from 2D has an assumed size, and its distance follows from the size: a mug of known size would be
apart from the hand that holds it. So the hand is scaled about the camera to the distance that a sensor's depth shows.
Without depth the object's size is free beside the hand's in the fit, and the result is scaled until the object has its
known size. The stated size of a built-in shape is uncertain, too: it is the largest side of the object, whose other
sides are a guess. Then the size is free beside any hand, and hand and object share the disagreement by the variances of
their sizes: a measured hand, whose size is exact, stays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, read_masks
from getagrip.clip.depth import DEPTH_KEY, MAX_DEPTH_RATIO, Depth
from getagrip.fitting.energy import OnHand
from getagrip.fitting.energy.depth_term import median_hand_depth_ratio, sample_depth
from getagrip.fitting.hand.hand_error_model import ROTATION_ERRORS, SIZE_ERROR, TRANSLATION_ERRORS, SolvedHand
from getagrip.fitting.hand.refine_hand import HandRefinement, assumed_errors
from getagrip.fitting.motion import HandPrior, Motion, MovingHand
from getagrip.fitting.motion.moving_hand import RAY_SHIFT_INDEX, SHIFT_SLICE, TURN_SLICE
from getagrip.fitting.objective import energy_of_nat, hand_evidence_energy, sum_energies
from getagrip.fitting.options import Options
from getagrip.fitting.problem import EnergyOf, Problem, sample_clip_frames
from getagrip.fitting.solver.solve import evaluate, inverse_of_shared, minimise
from getagrip.provenance import assumed, estimated, is_assumed
from getagrip.result import Reconstruction

HAND_SIZE_SIGMA = 0.1
"""Standard deviation of the logarithm of a lifted hand's size. Assumed; 0.1 to 0.6 do alike (docs/trials.md)."""
STATED_SIZE_SIGMA = 0.1
"""Standard deviation of the logarithm of the size at which a built-in shape looks as large as an object whose largest
side it has: 0.11 of 15 scans of YCB, by the areas of their hulls."""
HAND_SIZE_FROM_BOTH = assumed("between a mean hand's and that which follows from the size stated for a guessed shape")
HAND_SIZE_FROM_OBJECT = assumed("it follows from the object's, which is known")
HAND_SIZE_FROM_DEPTH = estimated("from the distance at which a sensor's depth shows the hand")
N_HAND_SIZE_FRAMES, MAX_HAND_SIZE_SAMPLES, MIN_HAND_SIZE_SAMPLES = 12, 100, 20
"""Number of frames whose depth is read; maximum number of the hand's samples in each; minimum number in all frames."""


def with_hand_size(clip: Clip, options: Options) -> Clip:
    """Return the clip with a lifted hand at the distance of a sensor's depth, and the object's size free where it is.

    A stated size is free beside a lifted hand without a sensor's depth, and if it is that of a guessed shape. Other
    clips stay unchanged. So do timelines, some of whose segments are solved without a hand.
    """
    if clip.segments or options.as_published:
        return clip
    lifted = is_assumed(clip.provenance.get("hands_scale"))
    size = hand_size_from_depth(clip) if lifted else np.nan
    if not np.isnan(size):
        hand = replace(clip.hand.scaled(size), T_cam_hand=_scale_translations(clip.hand.T_cam_hand, size))
        known = clip.provenance | {"hands_scale": HAND_SIZE_FROM_DEPTH}
        clip, lifted = replace(clip, hand=hand, hand_scale=size, provenance=known), False
    guessed = is_assumed(clip.provenance.get("mesh"))
    if clip.scale != "known" or not (lifted or guessed):
        return clip
    source = HAND_SIZE_FROM_BOTH if guessed else HAND_SIZE_FROM_OBJECT
    known = clip.provenance | ({"hands_scale": source} if lifted else {})
    sigmas = HAND_SIZE_SIGMA if lifted else 0.0, STATED_SIZE_SIGMA if guessed else 0.0
    return replace(clip, scale="free", size_sigmas=sigmas, provenance=known)


def hand_size_from_depth(clip: Clip) -> float:
    """Return the ratio of the hand's distance in a sensor's depth to its input distance; NaN where unknown.

    Raises ``InputError`` for masks and depth that cannot be read.
    """
    few, depth = sample_sensor_depth(clip, N_HAND_SIZE_FRAMES)
    if depth is None:
        return np.nan
    samples = sample_depth(few, read_masks(few), depth, MAX_HAND_SIZE_SAMPLES)
    size, on_hand = median_hand_depth_ratio(samples), np.sum(samples.used - samples.on_object)
    return size if on_hand >= MIN_HAND_SIZE_SAMPLES and abs(np.log(size)) < np.log(MAX_DEPTH_RATIO) else np.nan


def sample_sensor_depth(clip: Clip, frames: int) -> tuple[Clip, Depth | None]:
    """Return some frames of the clip with a sensor's metric depth; None where it has none. Raises ``InputError``."""
    if not clip.evidence.get(DEPTH_KEY, clip.folder is not None and (clip.folder / DEPTH_KEY).exists()):
        return clip, None
    few = sample_clip_frames(clip, frames)
    depth = few.evidence.get(DEPTH_KEY)
    sensed = isinstance(depth, Depth) and (depth.source.scale, depth.source.source) == ("metric", "sensor")
    return few, depth if sensed and isinstance(depth, Depth) else None


def restore_object_size(result: Reconstruction, clip: Clip) -> Reconstruction:
    """Scale the result of a clip ``with_hand_size`` about the camera: an object of known size has it again.

    Of the disagreement with a size that is not certain either, the hand takes its share. The result of a clip whose
    size was not changed stays unchanged.
    """
    size = result.scale**-clip.hand_size_share
    if size * clip.hand_scale == 1.0:
        return result
    assert result.T_cam_hand is not None
    axis, found, covariance = result.axis, result.candidates, result.hand_covariance
    others = result.hand_alternatives
    units = np.array([size, size, size, 1.0, 1.0, 1.0])
    return replace(
        result,
        scale=result.scale ** (1.0 - clip.hand_size_share),
        T_hand_obj=_scale_translations(result.T_hand_obj, size),
        axis=None if axis is None else replace(axis, point=size * axis.point),
        candidates=replace(found, T_hand_obj=_scale_translations(found.T_hand_obj, size), scale=size * found.scale),
        T_cam_hand=_scale_translations(result.T_cam_hand, size),
        hand_scale=size * clip.hand_scale,
        hand_covariance=None if covariance is None else covariance * np.outer(units, units),
        hand_alternatives=None if others is None else _scale_translations(others, size),
    )


def _scale_translations(T: Float[ndarray, "*batch 4 4"], size: float) -> Float[ndarray, "*batch 4 4"]:
    out = T.copy()
    out[..., :3, 3] *= size
    return out


M = TypeVar("M", bound=Motion)

HAND_DEPTH_SIGMAS_M = 0.018, 0.007
"""Standard deviations of the error along the camera's ray, beside the error in any direction: the error that all frames
share, and each frame's own [m], as in estimates from images (docs/datasets.md)."""
HAND_PRIOR_WEIGHT = 0.5
"""Weight of the prior, relative to the hand's refinement: hands of different clips differ in accuracy, so that the
prior's tails are heavier than a square's. Chosen on training clips."""
HAND_STUDENT_T_DOF = 2.0
"""Degrees of freedom of Student's t: a clip's shift, turn and depth may each be off by more than is assumed."""
HAND_OBJECT_LEVEL_PX, HAND_OBJECT_ITERATIONS, WIDENED_PRIOR_ITERATIONS = 128, 8, (4, 4)
"""Resolution [px]; maximum number of iterations, first and in each round under a prior as wide as the errors before."""


def solve_with_hand(problem: Problem, motion: M, energy_of: EnergyOf) -> tuple[SolvedHand, M]:
    """Solve the first hypothesis together with the hand; return the hand, and all motions in it.

    The other hypotheses move with the hand. The problem has a refined hand (``Problem.refinement``).
    """
    refinement = problem.refinement
    assert refinement is not None
    frames, nat = np.arange(len(problem.clip)), energy_of_nat(problem)
    T_input = refinement.seen.errors.tracked.T_cam_hand
    unrefined = replace(problem, clip=problem.clip.with_hand_at(T_input))
    terms = sum_energies(energy_of(unrefined), hand_evidence_energy(unrefined))(HAND_OBJECT_LEVEL_PX, frames)
    start = _motion_in_moving_hand(refinement, motion.take(np.zeros(1, int)), nat)
    found = minimise(start, terms, T_input, HAND_OBJECT_ITERATIONS)
    for iterations in WIDENED_PRIOR_ITERATIONS:
        assumed = start.assumed.widened(found.motion.constant[0], found.motion.own[0], HAND_STUDENT_T_DOF)
        found = minimise(replace(found.motion, assumed=assumed), terms, T_input, iterations)
    x = _hand_errors(found.motion, refinement)
    begun = evaluate(start, terms, T_input, np.full(1, np.inf)).values[0]
    names = [term.name for term in terms if isinstance(term, OnHand)]
    before = dict(zip((term.name for term in terms), begun, strict=False))
    energy = {name: (float(before[name]), float(found.terms[name][0])) for name in names}
    covariance = nat * _covariance(found.motion, inverse_of_shared(found.motion, terms, T_input, last=8))
    hand = SolvedHand(refinement.seen.errors.T_cam_hand(x), covariance, energy, refinement.seen.share(x))
    return hand, found.motion.core.concatenate(motion.take(np.arange(1, len(motion.poses().scale))))


def _motion_in_moving_hand(refinement: HandRefinement, motion: M, nat: float) -> MovingHand[M]:
    """Put a motion into the refined hand."""
    loose = any(
        joints is not None and joints.loose for joints in (refinement.joints, *(v.joints for v in refinement.views))
    )
    assumed = assumed_errors("estimated", loose, 1 + len(refinement.views))
    bias, jitter, (shared_depth, own_depth) = assumed.bias, assumed.jitter, HAND_DEPTH_SIGMAS_M
    constant = _concatenate_errors(bias, shared_depth, bias[SIZE_ERROR])
    prior = HandPrior.of(
        refinement.seen.errors.tracked, constant, _concatenate_errors(jitter, own_depth), HAND_PRIOR_WEIGHT * nat
    )
    size = refinement.shared[SIZE_ERROR] + refinement.own[:, SIZE_ERROR].mean()
    return replace(
        MovingHand.around(motion, prior),
        constant=_concatenate_errors(refinement.shared, 0.0, size)[None],
        own=np.stack([_concatenate_errors(errors, 0.0) for errors in refinement.own])[None],
    )


def _concatenate_errors(x: Float[ndarray, "P"], *others: float) -> Float[ndarray, "D"]:
    """Order errors as ``MovingHand`` does: shift, turn, shift along the ray, logarithm of the size."""
    return np.concatenate([x[TRANSLATION_ERRORS], x[ROTATION_ERRORS], others])


def _hand_errors(motion: MovingHand[M], refinement: HandRefinement) -> Float[ndarray, "N P"]:
    """Return the hand's errors in every frame as ``HandErrors`` orders them; the fingers stay as refined."""
    x, solved = refinement.shared + refinement.own, motion.constant[0, :-1] + motion.own[0]
    x[:, ROTATION_ERRORS], x[:, SIZE_ERROR] = solved[:, TURN_SLICE], motion.constant[0, -1]
    x[:, TRANSLATION_ERRORS] = solved[:, SHIFT_SLICE] + solved[:, RAY_SHIFT_INDEX, None] * motion.assumed.rays
    return x


def _covariance(motion: MovingHand[M], inverse: Float[ndarray, "8 8"]) -> Float[ndarray, "6 6"]:
    """Return the covariance of the shift and turn that all frames share, with the shift along the mean ray."""
    J = np.eye(6, 8)
    J[:3, RAY_SHIFT_INDEX] = motion.assumed.rays.mean(axis=0)
    return np.asarray(J @ inverse @ J.T)
