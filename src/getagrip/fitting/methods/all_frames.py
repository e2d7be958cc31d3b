"""Methods that fit all frames together by a motion model of the object in the hand.

``soft_hinge`` and ``one_dof`` are ours, after the paper's 1-DoF (Eq. 3); ``static`` and ``dynamic`` are the paper's
baselines; ``fit_contact_consistency`` is the authors' later in-hand model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import Energy
from getagrip.fitting.energy.in_view import VIEW_SEPARATOR
from getagrip.fitting.hand.hand_error_model import SolvedHand
from getagrip.fitting.hand.joint_hand_object import solve_with_hand
from getagrip.fitting.methods import OnStage
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion, Soft
from getagrip.fitting.objective import (
    NO_TERMS,
    all_masks_energy,
    depth_order_energy,
    distance_consistency_energy,
    energy_of,
    handle_energy,
    sum_energies,
)
from getagrip.fitting.problem import EnergyOf, MethodResult, Problem
from getagrip.fitting.solver.category_prior import (
    category_energy,
    category_rotations,
    handle_half_turns,
    handle_poses,
)
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.fitting.solver.search import DEFAULT_SCHEDULE, THOROUGH_SCHEDULE, Search
from getagrip.fitting.solver.solve import Solution, minimise
from getagrip.fitting.stages.mesh_deformation import fit_shape, relative_contour_error, stiffen_ridge
from getagrip.geometry.warp import Warp
from getagrip.result import Axis

M = TypeVar("M", bound=Motion)

COARSE_RIDGE = (2e5 / 4, 1.2e3 / 4)
"""Stiffness of a soft hinge's deviations in the coarse stages, where it has no axis yet [px^2 per m^2, per rad^2]."""
SOFT_RIDGE = (1.5e6, 1e4)
"""Stiffness of a soft hinge's deviations in the fine stages, in the same units; more for a template mesh that is not
fitted."""
SOFT_HINGE_CONSISTENCY_WEIGHT, CONTACT_CONSISTENCY_WEIGHT = 0.5, 0.1
"""Weights of contact consistency (``objective.distance_consistency_energy``): the soft hinge's, in lambda_3, and the
weight in the method ``contact-consistency``, 1 in the authors' code."""
MISFIT_LEVEL_PX, MISFIT_ITERATIONS = 128, 4
"""Resolution [px] and iterations of the fit that measures the misfit."""
CONTACT_ONLY_FACTOR = 4.0
"""Factor on push and pull where no other term couples the object to the hand."""


def soft_hinge(problem: Problem, on_stage: OnStage, more: EnergyOf | None = None) -> MethodResult:
    """Fit a hinge, and a small deviation from it in each frame.

    ``more`` returns a user's own terms for a problem. They count in all stages and in all frames, so ``more`` is also
    called for problems in frames that were not sampled.
    """

    def own(problem: Problem) -> Energy:
        return NO_TERMS if more is None else more(problem)

    search = search_of(problem, on_stage)
    rough, warp, ridge = coarse_fit(problem, search, own(problem)), None, SOFT_RIDGE
    if problem.options.mesh == "fitted":
        warp = fit_mesh_shape(problem, search, rough.motion)
    else:
        ridge = stiffen_ridge(SOFT_RIDGE, misfit_of(problem, search, rough.motion))
    if warp is not None:
        problem = problem.warped(warp)
        search = replace(search, surface=problem.surface)
        rough = coarse_fit(problem, search, own(problem))

    def energy(problem: Problem) -> Energy:
        return sum_energies(soft_energy(problem), own(problem))

    found, hand = fine_fit_with_hand(problem, search, soft_hinge_of(problem, search, rough, ridge), energy)
    return replace(make_method_result(found, found.motion.core, energy), warp=warp, hand=hand)


def soft_hinges(problem: Problem, on_stage: OnStage, more: Energy = NO_TERMS) -> Solution[Soft[Hinge]]:
    """Search for soft hinges without fitting the mesh; return distinct solutions, best first."""
    search = search_of(problem, on_stage)
    rough = coarse_fit(problem, search, more)
    ridge = stiffen_ridge(SOFT_RIDGE, misfit_of(problem, search, rough.motion))
    energy = add_contact_consistency(problem, sum_energies(coarse_energy(problem), more))
    return search.fine(soft_hinge_of(problem, search, rough, ridge), energy)


def refit_hinge(problem: Problem, found: MethodResult, frames: Float[ndarray, "n"], on_stage: OnStage) -> MethodResult:
    """Run the fine stages from the solutions of a fit at other frames of the same clip.

    ``frames`` are the places of the problem's frames among that fit's, between two of them where it lacked a frame.
    """
    assert found.motion is not None
    assert found.energy_of is not None
    motion = found.motion.resampled(np.arange(found.poses.R.shape[1]), frames)
    again = search_of(problem, on_stage).fine(motion, found.energy_of(problem))
    hinge = again.motion.core if isinstance(again.motion, Soft) else again.motion
    return make_method_result(again, hinge if isinstance(hinge, Hinge) else None, found.energy_of)


def coarse_fit(problem: Problem, search: Search, more: Energy) -> Solution[Soft[Fixed]]:
    """Run the coarse stages without an axis: constrained to one too early, right poses off a hinge would lose."""
    energy = sum_energies(coarse_energy(problem), more)
    relaxed = search.relax(make_initial_poses(problem), energy)
    return search.coarse(replace(relaxed, ridge=COARSE_RIDGE), energy)


def fine_fit_with_hand(
    problem: Problem, search: Search, motion: M, energy: EnergyOf
) -> tuple[Solution[M], SolvedHand | None]:
    """Run the fine stages; before the last one, solve a refined hand together with the object."""
    if problem.refinement is None:
        return search.fine(motion, energy(problem)), None
    before = search.fine(motion, energy(problem), slice(-1)).motion
    hand, motion = solve_with_hand(problem, before, energy)
    search = replace(search, T_cam_hand=hand.T_cam_hand)
    return search.fine(motion, energy(problem.with_hand(hand)), slice(-1, None)), hand


def soft_hinge_of(
    problem: Problem, search: Search, rough: Solution[Soft[Fixed]], ridge: tuple[float, float]
) -> Soft[Hinge]:
    """Return the soft hinges nearest to the coarse stages' solutions, at all frames."""
    motion = search.at_all_frames(rough.motion)
    ridge = (problem.trust.firmness * ridge[0], problem.trust.firmness * ridge[1])
    return Soft.around(hinge_of(problem, motion), motion.poses(), ridge)


def misfit_of(problem: Problem, search: Search, rough: Soft[Fixed]) -> float:
    """Measure the misfit of the best hypothesis, after a fit to the masks without contact."""
    frames = search.coarse_frames
    terms, T_cam_hand = all_masks_energy(problem)(MISFIT_LEVEL_PX, frames), problem.clip.hand.T_cam_hand[frames]
    fitted = minimise(rough, terms, T_cam_hand, MISFIT_ITERATIONS, threads=problem.threads)
    each = [relative_contour_error(problem.observation, fitted.terms["mask"] / len(frames))]
    for view in problem.views:
        if shown := np.count_nonzero(np.isin(frames, view.rows)):
            mask = fitted.terms[f"mask{VIEW_SEPARATOR}{view.name}"]
            each.append(relative_contour_error(view.observation, mask / shown))
    return float(np.mean(each, axis=0).min())


def fit_mesh_shape(problem: Problem, search: Search, rough: Soft[Fixed]) -> Warp | None:
    """Fit the mesh to the masks after the coarse stages; None where the input mesh explains them."""
    return fit_shape(problem, rough, search.coarse_frames, misfit_of(problem, search, rough))


def soft_energy(problem: Problem) -> Energy:
    """Return the soft hinge's energy at all frames."""
    return add_contact_consistency(problem, coarse_energy(problem))


def one_dof(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a hinge (Eq. 3): ours, after the paper, whose own method is ``methods.paper``.

    The mesh is fitted by the same step as the soft hinge's, so that the two differ in the motion alone. The step needs
    the soft hinge's coarse stages, so it is left out where small deviations from the hinge explain the masks already.
    """
    search, warp = search_of(problem, on_stage), None
    rough = coarse_hinge(problem, search)
    around = Soft.around(rough.motion.base, rough.motion.poses(), COARSE_RIDGE)
    if problem.options.mesh == "fitted" and fit_mesh_shape(problem, search, around) is not None:
        quiet = replace(search, on_stage=lambda stage: None)
        warp = fit_mesh_shape(problem, quiet, coarse_fit(problem, quiet, NO_TERMS).motion)
    if warp is not None:
        problem = problem.warped(warp)
        search = replace(search, surface=problem.surface)
        rough = coarse_hinge(problem, search)
    found, hand = fine_fit_with_hand(problem, search, search.at_all_frames(rough.motion), contact_only_energy)
    return replace(make_method_result(found, found.motion, contact_only_energy), warp=warp, hand=hand)


def coarse_hinge(problem: Problem, search: Search) -> Solution[Hinge]:
    """Run the coarse stages with a hinge."""
    energy = contact_only_energy(problem)
    return search.coarse(hinge_of(problem, search.relax(make_initial_poses(problem), energy)), energy)


def static(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit one pose for all frames (paper, Sec. 5.2)."""
    search, energy = search_of(problem, on_stage), contact_only_energy(problem)
    motion = search.relax(make_initial_poses(problem), energy).core
    return make_method_result(search.run(motion, energy))


def dynamic(problem: Problem, on_stage: OnStage, energy_of: EnergyOf | None = None) -> MethodResult:
    """Fit a pose per frame (paper, Sec. 5.2), by ``energy_of``, or else by push, pull and all evidence."""
    energy_of = energy_of or contact_only_energy
    search, energy = search_of(problem, on_stage), energy_of(problem)
    relaxed = search.relax(make_initial_poses(problem), energy)
    shared = relaxed.poses()
    motion = Free(shared.R, shared.centre, relaxed.core.log_scale, relaxed.core.free_scale)
    return make_method_result(search.run(motion, energy), energy_of=energy_of)


def contact_only_energy(problem: Problem) -> Energy:
    """Return Eq. 5 where no other term couples the object to the hand."""
    return total_energy(problem, CONTACT_ONLY_FACTOR)


def total_energy(problem: Problem, contact: float) -> Energy:
    """Return Eq. 5, with ``contact`` times the options' push and pull, and the terms on lifted or unmeasured inputs."""
    contact *= problem.trust.contact
    contacts = energy_of(problem, contact * problem.options.push, contact * problem.options.pull)
    own = depth_order_energy(problem), category_energy(problem.clip)
    return sum_energies(handle_energy(problem), contacts, *own)  # a saving first: bounds of further terms count it


def coarse_energy(problem: Problem) -> Energy:
    """Return the soft hinge's energy at some of the frames: Eq. 5."""
    return total_energy(problem, 1.0 if problem.options.pull else CONTACT_ONLY_FACTOR)


def add_contact_consistency(problem: Problem, energy: Energy) -> Energy:
    """Add contact consistency to an energy, for the soft hinge at all frames.

    Constant contacts make a grasp stable (Eq. 2). A hinge keeps contacts by itself; where frames may deviate from the
    hinge, above all in depth, which silhouettes hardly show, a term keeps them.
    """
    pull = problem.trust.contact * problem.trust.firmness * problem.options.pull
    if not pull:
        return energy
    return sum_energies(energy, distance_consistency_energy(problem, SOFT_HINGE_CONSISTENCY_WEIGHT * pull))


def search_of(problem: Problem, on_stage: OnStage) -> Search:
    """Make the search on a clip: thorough if the options say so, or for a lifted hand, which is inaccurate."""
    schedule = THOROUGH_SCHEDULE if problem.options.thorough or problem.trust.hand_lifted else DEFAULT_SCHEDULE
    opposite = handle_half_turns(problem.clip, problem.surface)
    return Search(problem.clip.hand.T_cam_hand, problem.surface, schedule, on_stage, problem.threads, opposite)


def make_initial_poses(problem: Problem) -> Fixed:
    """Make the initial poses, at all frames."""
    usual = category_rotations(problem.clip) if problem.options.init == "uniform" else None
    poses = initial_poses(problem.clip, problem.masks, problem.inits, problem.options.seed, problem.prior_poses, usual)
    return poses if usual is None else poses.concatenate(handle_poses(problem, poses))


def hinge_of(problem: Problem, relaxed: Soft[Fixed]) -> Hinge:
    """Return the hinge nearest to a relaxed fit, its axis located as the options allow."""
    return Hinge.nearest(relaxed.core, relaxed.deviation, problem.options.axis == "free", anchor=np.zeros(3))


def make_method_result(
    found: Solution[M], hinge: Hinge | None = None, energy_of: EnergyOf | None = None
) -> MethodResult:
    """Make a result of solutions, with the axis of the best, from ``hinge``: the motion or its core.

    ``energy_of`` is the energy by which the motion is fitted in other frames; None: poses are interpolated.
    """
    motion: Motion = found.motion
    axis = None
    if hinge is not None:
        best = hinge.zero_mean()
        axis = Axis(best.point[0], best.direction[0], best.angle[0])
        motion = replace(motion, core=best) if isinstance(motion, Soft) else best
    terms = {name: float(value[0]) for name, value in found.terms.items()}
    own = motion if energy_of else None
    return MethodResult(found.motion.poses(), found.energy, terms, found.status[0], axis, own, energy_of)


def fit_contact_consistency(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a pose per frame, with contact consistency in all stages: the authors' later in-hand model.

    Raises ``GetagripError`` when no pose can be rendered.
    """

    def energy(problem: Problem) -> Energy:
        consistency = distance_consistency_energy(problem, CONTACT_CONSISTENCY_WEIGHT, exact=True)
        return sum_energies(total_energy(problem, contact=1.0), consistency)

    return dynamic(problem, on_stage, energy)
