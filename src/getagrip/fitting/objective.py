"""The energy of Eq. 5 for a clip, at any of its resolutions and frames: E_mask, E_push and E_pull.

Other evidence of the clip counts beside its masks (``object_evidence_energy``). A method adds its own terms where it
builds its energy: ``sum_energies(energy_of(...), mine)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy import Energy, HandEnergy, HandTerm, InHand, OnHand, Term
from getagrip.fitting.energy.contact import HandContacts, PullTerm, PushTerm, farthest_point_sampling
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.hand_terms import HandMaskTerm, SeenJointsTerm
from getagrip.fitting.energy.handle_grip import HandleTerm, finger_middles
from getagrip.fitting.energy.in_view import ViewedEnergy
from getagrip.fitting.energy.mask import MaskTerm
from getagrip.fitting.energy.occlusion_order import HandOrder, OrderTerm, corners_of
from getagrip.fitting.hand.hand_silhouette import HandSilhouette, hand_crops
from getagrip.fitting.hand.joint_reprojection import SeenJoints
from getagrip.fitting.hand.refine_hand import HAND_PIXEL_WEIGHT
from getagrip.fitting.problem import Problem

MASK_STEP_PX = {64: 1.0, 128: 2.0, 256: 3.0}
"""Distance of contour points at each level [px of the level]."""
MIN_CURVATURE_DISTANCE_PX = {64: 2.0, 128: 1.0, 256: 1.0}
"""Distances below this count as this in the curvature of E_mask [px of the crop]."""
PUSH_WEIGHT, PULL_WEIGHT = 0.125, 0.015
"""Fractions of the masks' mean area that push and pull are multiplied by. The paper sums E_mask over pixels, which
leaves push and pull without effect; the authors' code divides E_mask by the area of the mask instead. Pull has less
weight: a hand may well not touch the object with all five fingertips, but it cannot enter the object.
"""
HANDLE_WEIGHT = 0.1
"""Weight of a handle's distance from the fingers, in that of pull."""
N_CONSISTENCY_REGION_POINTS, N_CONSISTENCY_OBJECT_POINTS = 2, 8
"""Number of points of each contact region, and of the object, in the term of contact consistency."""


def energy_of(problem: Problem, push: float, pull: float) -> Energy:
    """Return E_mask, the terms of other evidence, E_push and E_pull."""
    return sum_energies(object_evidence_energy(problem), contact_energy(problem, push, pull))


def object_evidence_energy(problem: Problem) -> Energy:
    """Return the terms of all evidence on the object: E_mask first, since masks are the first modality."""
    return sum_energies(*(terms.object for terms in problem.evidence if terms.object is not None))


def hand_evidence_energy(problem: Problem) -> Energy:
    """Return the terms of all evidence on a hand whose pose is unknown; nothing where the hand is fixed."""
    energies = [terms.hand for terms in problem.evidence]
    return lambda level, index: [OnHand(one) for hand in energies if hand is not None for one in hand(level, index)]


def hand_mask_energy(problem: Problem) -> HandEnergy:
    """Return E_mask of the hand; a pixel of the image counts as much as one of the object's mask."""

    @cache
    def seen() -> HandSilhouette:
        if problem.refinement is not None:
            return replace(problem.refinement.seen, errors=problem.refinement.bent)
        return HandSilhouette.of(problem.clip, problem.input_masks).with_field

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[HandTerm]:
        some = seen().take(index)
        return [HandMaskTerm(some, (problem.observation.K[index, 0] / some.mask.K[:, 0]) ** 2)]

    return terms


def reprojection_energy(problem: Problem) -> HandEnergy:
    """Return the reprojection of the hand's joints."""

    @cache
    def seen() -> SeenJoints | None:
        refinement = problem.refinement
        if refinement is None:
            return SeenJoints.of(problem.clip, problem.input_masks)
        return refinement.joints and replace(refinement.joints, errors=refinement.bent)

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[HandTerm]:
        joints = seen()
        return [] if joints is None else [SeenJointsTerm(joints.take(index), energy_of_nat(problem))]

    return terms


def energy_of_nat(problem: Problem) -> float:
    """Compute the energy that is worth a nat of likelihood [px^2 of the object's crop]."""
    crop = hand_crops(problem.clip).intrinsics(problem.clip.K)[:, 0, 0]
    return float(np.mean((problem.observation.K[:, 0] / crop) ** 2)) / HAND_PIXEL_WEIGHT


def mask_energy(problem: Problem) -> Energy:
    """Return E_mask."""
    observation, mesh = problem.observation, problem.surface.silhouettes

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
        step, delta, coverage = MASK_STEP_PX[level], MIN_CURVATURE_DISTANCE_PX[level], 1.0 if level == 64 else 0.0
        return [MaskTerm(mesh[level], observation.take(index), level, step, delta, coverage)]

    return terms


def all_masks_energy(problem: Problem) -> Energy:
    """Return E_mask of the clip's own view, and of all further ones."""
    views = (
        ViewedEnergy(mask_energy(problem.in_view(view)), view.name, view.rows, view.T_view_cam)
        for view in problem.views
    )
    return sum_energies(mask_energy(problem), *views)


def contact_energy(problem: Problem, push: float, pull: float) -> Energy:
    """Return E_push and E_pull, with lambda_f, the focal length in pixels of the crop.

    ``push`` and ``pull`` are the paper's lambda_2 and lambda_3 without the focal length; weight 0 leaves a term out.
    """
    push_weight, pull_weight = contact_weights(problem, push, pull)
    return sum_energies(
        push_energy(problem, push_weight) if push else NO_TERMS, pull_energy(problem, pull_weight) if pull else NO_TERMS
    )


def contact_weights(problem: Problem, push: float, pull: float) -> tuple[Float[ndarray, "N"], Float[ndarray, "N"]]:
    """Compute the weight of a metre of mean push and of mean pull in each frame, by the masks' mean area [px^2 / m]."""
    unit = problem.observation.area.mean() * problem.observation.K[:, 0]
    return push * PUSH_WEIGHT * unit, pull * PULL_WEIGHT * unit


def push_energy(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return our E_push, by its weight in each frame [px^2 / m]."""
    hands, solid = problem.contacts, problem.surface.solid
    return lambda level, index: [InHand(PushTerm(solid, hands[level].take(index), weight[index]))]


def pull_energy(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return our E_pull, by its weight in each frame [px^2 / m]."""
    hands, solid, reach = problem.contacts, problem.surface.solid, problem.trust.reach
    return lambda level, index: [InHand(PullTerm(solid, hands[level].take(index), weight[index], reach))]


def depth_order_energy(problem: Problem) -> Energy:
    """Return the term of order in depth, by the weight of push, for lifted hands with hand masks.

    Other hands' distances come from their estimators; penetrations that push leaves in them are small.
    """
    masks, weight = problem.input_masks, problem.trust.contact * problem.options.push
    if not (problem.trust.hand_lifted and weight) or masks.hand is None:
        return NO_TERMS
    corners, (each, _) = corners_of(problem.clip.mesh), contact_weights(problem, weight, 0.0)
    hand = HandOrder.of(problem.clip.hand, problem.clip.K, masks)
    return lambda level, index: [InHand(OrderTerm(corners, hand.take(index), each[index]))]


def handle_energy(problem: Problem) -> Energy:
    """Return the saving of a handle that lies within the fingers, by the weight of pull; none without a handle."""
    handle, fingers = problem.handle, finger_middles(problem.clip.hand)
    pull = problem.trust.contact * problem.options.pull
    if handle is None or fingers is None or not pull:
        return NO_TERMS
    weight = HANDLE_WEIGHT * contact_weights(problem, 0.0, pull)[1]
    return lambda level, index: [InHand(HandleTerm(handle, fingers[index], weight[index]))]


def distance_consistency_energy(problem: Problem, weight: float, exact: bool = False) -> Energy:
    """Return the term by which hand and object keep their distances, at any level.

    ``weight`` multiplies the mean absolute change of squared distances, besides the focal length and the masks' mean
    area: 1 in the authors' later code. ``exact`` as in the term: for motions without a shared pose.
    """
    observation = problem.observation
    vertices = problem.clip.mesh.vertices - problem.clip.mesh.centre
    points = vertices[farthest_point_sampling(vertices, N_CONSISTENCY_OBJECT_POINTS)]
    hand = HandContacts.of(problem.clip.hand, N_CONSISTENCY_REGION_POINTS)
    # The authors' E_mask is divided by the mask's area, ours is not.
    each = weight * observation.area.mean() * observation.K[:, 0]
    return lambda level, index: [InHand(ContactConsistencyTerm(points, hand.position[index], each[index], exact=exact))]


def sum_energies(*energies: Energy) -> Energy:
    """Join the terms of all energies."""
    return lambda level, index: [term for energy in energies for term in energy(level, index)]


NO_TERMS = sum_energies()
"""No term."""
