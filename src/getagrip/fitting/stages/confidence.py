"""Confidence in a result without ground truth: measures for its checks, and the probability that its poses are right.

**Pose spread** is the standard deviation of the object's pose by the energy's curvature: the Gauss-Newton covariance of
the parameters that all frames share (base pose, axis, scale), with each frame's own parameters at their optimum,

    S = noise inverse(sum_n H_ss - H_sl inverse(H_ll) H_ls),   noise = E_mask of a frame

E_mask in place of an observation's variance is a rule of thumb: badly met contours tell less. Hessians between frames,
other minima, and errors of hand and mesh are left out.

**Scale check**: does the energy prefer another scale than the known one? A few iterations continue from the solution
with a free scale. If mesh, hand and camera agree in size, the energy hardly falls: contact with the hand determines the
depth, and depth and masks determine the size.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks import SolvedEvidence
from getagrip.checks.calibration import (
    CALIBRATIONS,
    CORRECTED_CALIBRATIONS,
    ESTIMATED_CALIBRATIONS,
    KEEP_THRESHOLDS,
    LIFTED_CALIBRATIONS,
    LIFTED_KINDS,
    InputKind,
    Where,
    kind_of_input,
    sigmoid,
)
from getagrip.checks.evidence import was_lifted
from getagrip.checks.features import was_corrected
from getagrip.clip import Clip
from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.in_view import term_in_any_view
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX
from getagrip.fitting.hand.hand_error_model import rigid_point_jacobian
from getagrip.fitting.motion import transform_poses
from getagrip.fitting.objective import handle_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.category_prior import opening_angle
from getagrip.fitting.solver.solve import hessian, minimise
from getagrip.fitting.stages.distance import distance_spread
from getagrip.fitting.stages.mesh_deformation import relative_contour_error
from getagrip.fitting.stages.remaining_frames import SolutionTrack
from getagrip.geometry import se3
from getagrip.least_squares import BlockArrow
from getagrip.provenance import is_assumed, kind_of_hands
from getagrip.result import Candidates
from getagrip.result.findings import ASSUMED_MESH, Finding, Probability

MIN_RELATIVE_CERTAINTY = 1e-6
"""Minimum certainty of a direction that leaves the energy unchanged (a bottle's spin), in that of the most certain."""
SCALE_CHECK_LEVEL_PX, SCALE_CHECK_ITERATIONS = 128, 8
"""Resolution [px] and iterations of the fit with a free scale."""
CALIBRATION_NEUTRAL_OPTIONS = (
    "method", "inits", "init", "priors", "priors_only", "thorough", "seed", "frames", "every_frame",
)  # fmt: skip
"""Options that leave a calibration valid; it was made with the default values of all options."""
CALIBRATED_TERMS = (
    "total", "mask", "push", "pull", "consistency", "prior", "hand-mask", "joints-2d", "depth",
    "order", "size", "upright", "opening", "handle",
)  # fmt: skip
"""Names of the calibrated energy's terms. The last five the calibration did not have, the last of them only for objects
with a handle, the others for assumed inputs, such as the object's category; its probability is carried over to them."""
HAND_ALTERNATIVE_DISTANCE = 0.14
"""Distance by which alternatives of a hand move the object in it [diameters]; a pose is right within 0.1. Chosen on
training clips."""
UNCALIBRATED_DEPTH_FINDINGS = "depth-elsewhere", "depth-misfit", "depth-warped"
"""Findings that nearly no result of the calibration had: with them no fraction of right results can be promised."""
UNEXPLAINED_OPENING, MAX_PROBABILITY_WITH_OPENING = "opening-away", 0.25
"""A finding with which no result may be said to look right, and the most probability that it leaves: vessels are seen
from above. The calibration has no such results; on two videos, both were tilted wrongly."""
VIEWS_SIGN = "views"
"""Number of views that a result with further ones was fitted to, among its signs."""
VIEW_LOGITS: Mapping[Where, float] = {"hand": 1.5, "camera": 0.7, "image": 0.0}
"""Logarithm of odds that each doubling of the number of views adds to the probability of a result. Calibrations are of
single views; 1.7 and 1.05 are most probable by training clips with two and four views, of which two in 179 were wrong.
"""
REAL_VIDEO_LOGIT = -2.5
"""Logarithm of odds that is added to the probability that a draft looks right, which is fitted to rendered videos above
all. Chosen on real ones: of 24 results with known poses 71 % were right, and 96 % said; of 15 drafts of public videos
that were judged by eye two were, and 57 % said (docs/checks.md)."""
ESTIMATED_HAND_SPREAD_M = 0.03
"""Standard deviation of an object in an estimated hand that was not solved with it [m], as measured (docs/datasets.md).
"""


def solved_of(
    input_clip: Clip, problem: Problem, found: MethodResult, sampled: SolutionTrack, whole: SolutionTrack
) -> SolvedEvidence:
    """Collect a result's measures for its checks and signs.

    ``input_clip`` has the input hand and mesh; ``sampled`` and ``whole`` are the poses in the sampled frames and in
    every frame.
    """
    scale = float(found.poses.scale[0])
    deformed = 0.0 if found.warp is None else found.warp.displacement(input_clip.mesh)
    joints = problem.refinement and problem.refinement.joints
    return SolvedEvidence(
        problem.clip, problem.input_masks, sampled.T_hand_obj[0], scale, whole.iou,
        iou_frames=whole.frames, outliers=whole.outliers,
        deformed=deformed / input_clip.mesh.diameter, deformed_mm=1e3 * scale * deformed,
        candidates=Candidates(sampled.T_hand_obj, found.poses.scale, found.energy), axis=found.axis,
        hand_differing=problem.trust.hand_differing, joints_left_out=problem.trust.joints_left_out,
        T_cam_hand_input=input_clip.hand.T_cam_hand[input_clip.index_of(problem.clip.frames)],
        misfit=relative_contour_error(problem.observation, found.terms["mask"] / len(problem.clip)),
        spread=pose_spread(problem, found), hand_spread=_hand_spread(input_clip, problem, found),
        scale_check=scale_check(problem, found), joint_error=joints.size if joints else float("nan"),
        distance_spread=_distance_spread(input_clip, problem, found),
        turned_away=opening_angle(problem.clip, sampled.T_hand_obj[0]), texture=found.texture,
        handle_decided=handle_decided(problem, found), views_left_out=problem.trust.views_left_out,
        view_outliers=tuple(sorted(problem.trust.view_outliers)),
    )  # fmt: skip


def handle_decided(problem: Problem, found: MethodResult) -> float:
    """Compute how much more energy the result would have than another candidate without its handle's term [share].

    NaN of an object without a handle, and of a method without the term; 0 where the result is the best without it, too.
    """
    if "handle" not in found.terms:
        return float("nan")
    poses = transform_poses(found.poses, problem.clip.hand.T_cam_hand)
    (term,) = handle_energy(problem)(MASK_CROP_SIZE_PX, np.arange(len(problem.clip)))
    in_camera = PosesInCamera(poses.R, poses.centre, poses.scale)
    without = found.energy - term(in_camera, no_bound(in_camera)).value.sum(axis=1)
    return float(without[0] / without.min() - 1.0)


def _hand_spread(clip: Clip, problem: Problem, found: MethodResult) -> float:
    """Compute the standard deviation of the object in the hand by the hand's errors [m]."""
    if found.hand is None:
        return 0.0 if kind_of_hands(clip.provenance) == "measured" else ESTIMATED_HAND_SPREAD_M
    return found.hand.spread(_object_points_in_hand(problem, found) - _hand_centre(problem))


def _distance_spread(clip: Clip, problem: Problem, found: MethodResult) -> float:
    """Compute the standard deviation of the object's distance from the camera [diameters]."""
    middle = len(problem.clip) // 2
    centre = se3.transform(problem.clip.hand.T_cam_hand[middle], found.poses.centre[0, middle][None])[0]
    distance = float(np.linalg.norm(centre))
    return distance * distance_spread(clip, distance) / (float(found.poses.scale[0]) * problem.surface.diameter)


def hand_alternatives(problem: Problem, found: MethodResult) -> Float[ndarray, "M 4 4"] | None:
    """Return the alternative hand poses of a hand that was solved with the object; None of another hand."""
    if found.hand is None:
        return None
    middle = _hand_centre(problem)
    apart = HAND_ALTERNATIVE_DISTANCE * float(found.poses.scale[0]) * problem.surface.diameter
    return found.hand.alternatives(_object_points_in_hand(problem, found) - middle, middle, apart)


def _hand_centre(problem: Problem) -> Float[ndarray, "3"]:
    """Return the point that the solved hand turns about, in the hand [m]."""
    assert problem.refinement is not None
    return problem.refinement.seen.errors.tracked.vertices.mean(axis=(0, 1))


def _object_points_in_hand(problem: Problem, found: MethodResult) -> Float[ndarray, "P 3"]:
    """Return points of the object's surface in the hand, at the middle frame [m]."""
    n, scale = len(problem.clip) // 2, float(found.poses.scale[0])
    return scale * problem.surface.points @ found.poses.R[0, n].T + found.poses.centre[0, n]


def pose_spread(problem: Problem, found: MethodResult) -> float:
    """Compute the spread of the best solution in the middle frame, root mean square over the surface [diameters].

    NaN of a method without a motion model, or whose frames share no parameters.
    """
    if found.motion is None or found.energy_of is None:
        return float("nan")
    frames, T_cam_hand = np.arange(len(problem.clip)), problem.clip.hand.T_cam_hand
    motion = found.motion.take(np.zeros(1, int))
    J_shared = motion.jacobian()[0]
    S = J_shared.shape[-1]
    if S == 0:
        return float("nan")
    H, prior = hessian(motion, found.energy_of(problem)(MASK_CROP_SIZE_PX, frames), T_cam_hand), motion.prior()
    arrow = BlockArrow.of(H, np.zeros(H.shape[:-1]), slice(S), slice(S, None))
    arrow = arrow.plus(H_ll=prior.H + MIN_RELATIVE_CERTAINTY * np.eye(H.shape[-1] - S))
    certain, directions = np.linalg.eigh(arrow.reduced()[0])
    if not certain[-1] > 0.0:  # neither contour nor contact
        return float("nan")
    spread = directions / np.sqrt(np.maximum(certain, MIN_RELATIVE_CERTAINTY * certain[-1]))
    noise = found.terms["mask"] / len(frames)
    middle, scale = len(frames) // 2, float(found.poses.scale[0])
    x = scale * problem.surface.points @ found.poses.R[0, middle].T
    moved = np.concatenate([rigid_point_jacobian(x), x[..., None]], axis=-1) @ J_shared[0, middle] @ spread
    return float(np.sqrt(noise * np.mean(np.sum(moved**2, axis=(1, 2)))) / (scale * problem.surface.diameter))


def scale_check(problem: Problem, found: MethodResult) -> tuple[float, float]:
    """Return the factor on the scale that the energy prefers, and the fraction of energy that the factor saves.

    NaN where the scale was free, and of a method without a motion model.
    """
    if found.motion is None or found.energy_of is None or problem.clip.scale == "free":
        return float("nan"), float("nan")
    frames, T_cam_hand = np.arange(len(problem.clip)), problem.clip.hand.T_cam_hand
    terms, motion = found.energy_of(problem)(SCALE_CHECK_LEVEL_PX, frames), found.motion.take(np.zeros(1, int))
    before = float(minimise(motion, terms, T_cam_hand, 0).energy[0])
    after = minimise(motion.with_free_scale(), terms, T_cam_hand, SCALE_CHECK_ITERATIONS)
    factor = float(after.motion.poses().scale[0] / found.poses.scale[0])
    return factor, (before - float(after.energy[0])) / max(abs(before), 1e-9)


def probabilities(
    clip: Clip, options: Options, signs: Mapping[str, float], findings: Sequence[Finding], terms: Collection[str]
) -> dict[Where, Probability | None]:
    """Compute the probability that a result is right, in the hand, in the camera and, of lifted hands, in the image.

    ``terms`` are the names in its energy and in its hand's.
    """
    hands, depth = kind_of_hands(clip.provenance), signs.get("depth-images", 0.0)
    guessed_shape = is_assumed(clip.provenance.get("mesh"))
    kind = kind_of_input(
        hands, {*map(term_in_any_view, terms)}, depth, was_corrected(signs), was_lifted(clip), guessed_shape
    )
    found = {where: probability_right(options, signs, findings, where, terms, kind) for where in get_args(Where)}
    beyond = [finding.check for finding in findings if finding.check in UNCALIBRATED_DEPTH_FINDINGS]
    if guessed_shape and kind not in ("measured", "corrected", "lifted-shape"):  # calibrated on exact meshes only
        beyond.insert(0, ASSUMED_MESH)
    if beyond:
        kept = (right and replace(right, beyond=(*beyond, *right.beyond)) for right in found.values())
    else:
        kept = (right and KEEP_THRESHOLDS[kind, where].applied(right) for where, right in found.items())
    in_hand, in_camera, in_image = kept
    if in_image and any(finding.check == UNEXPLAINED_OPENING for finding in findings):
        value = min(in_image.value, MAX_PROBABILITY_WITH_OPENING)
        in_image = replace(in_image, value=value, beyond=(UNEXPLAINED_OPENING, *in_image.beyond), keep=0.0)
    # No pixel tells a wrong focal length from another distance.
    guessed = is_assumed(clip.provenance.get("camera"))
    return {"hand": in_hand, "camera": None if guessed else in_camera, "image": in_image}


def probability_right(
    options: Options,
    signs: Mapping[str, float],
    findings: Sequence[Finding],
    where: Where = "hand",
    terms: Collection[str] = (),
    kind: InputKind | None = None,
) -> Probability | None:
    """Compute the probability that a result with these signs is right; None if uncalibrated (``uncalibrated_reason``).

    ``findings`` are about the input and the result, ``kind`` is the input's; by default its hands are measured.
    """
    kind = kind or kind_of_input("measured", terms, 0.0, was_corrected(signs))
    by_kind = {"measured": CALIBRATIONS, "corrected": CORRECTED_CALIBRATIONS}
    by_kind |= dict.fromkeys(LIFTED_KINDS, LIFTED_CALIBRATIONS)
    calibrations = by_kind.get(kind, ESTIMATED_CALIBRATIONS)
    calibration = calibrations.get((options.method, where))
    if calibration is None or uncalibrated_reason(options, findings, terms):
        return None
    if not signs.keys() >= calibration.weights.keys():  # the signs of a user's own motion
        return None
    right = calibration.probability(signs)
    added = VIEW_LOGITS[where] * np.log2(signs.get(VIEWS_SIGN, 1.0)) + (REAL_VIDEO_LOGIT if where == "image" else 0.0)
    if not added or not 0.0 < right.value < 1.0:
        return right
    return replace(right, value=float(sigmoid(np.log(right.value / (1.0 - right.value)) + added)))


def uncalibrated_reason(options: Options, findings: Sequence[Finding], terms: Iterable[str] = ()) -> str:
    """Explain why a result has no probability of being right; empty where it has one.

    Uncalibrated are other methods and energies (``terms``: names), shorter searches, and serious findings: the
    calibration had no wrong inputs.
    """
    if not any(method == options.method for method, _ in CALIBRATIONS):
        return f"none is calibrated for {options.method}"
    if options.inits < Options.inits:
        return f"none is calibrated for fewer than {Options.inits} initial poses"
    if options.priors_only:
        return "none is calibrated without uniform rotations among the initial poses"
    for option in fields(Options):
        value = getattr(options, option.name)
        if option.name not in CALIBRATION_NEUTRAL_OPTIONS and value != option.default:
            return f"none is calibrated with {option.name} {value}"
    if others := [name for name in map(term_in_any_view, terms) if name not in CALIBRATED_TERMS]:
        return f"none is calibrated with the evidence {', '.join(others)}"
    return "a finding is serious" if any(finding.serious for finding in findings) else ""
