"""All frames fitted at once, the object moving in the hand as a motion model allows.

The authors' later in-hand model: Dynamic, but distances between hand and object are asked to stay the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from getagrip.fitting.energy import Energy
from getagrip.fitting.hand.hand_solution import SolvedHand
from getagrip.fitting.hand.joint_hand_object import solve_with_hand
from getagrip.fitting.methods import OnStage
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion, Soft
from getagrip.fitting.objective import (
    NO_TERMS,
    depth_order_energy,
    distance_consistency_energy,
    energy_of,
    mask_energy,
    sum_energies,
)
from getagrip.fitting.problem import EnergyOf, MethodResult, Problem
from getagrip.fitting.solver.category_prior import category_energy, category_rotations, handle_half_turns
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
"""Stiffness of a soft hinge's deviations in the fine stages, likewise; more where a mesh that is not the object's own
stays as it is."""
SOFT_HINGE_CONSISTENCY_WEIGHT = 0.5
"""Weight of the soft hinge's own term (``objective.consistency_of``), in lambda_3."""
MISFIT_LEVEL_PX, MISFIT_ITERATIONS = 128, 4
"""Resolution [px] and iterations of the fit that tells how badly the mesh explains the masks."""
CONTACT_ONLY_FACTOR = 4.0
"""Push and pull count so much more where no other term ties the object to the hand."""


def soft_hinge(problem: Problem, on_stage: OnStage, more: EnergyOf | None = None) -> MethodResult:
    """Fit a hinge, and a small deviation from it in each frame.

    ``more`` gives terms of one's own for a problem. They count in all stages and in all frames, so it is called again
    for problems in the frames that were not sampled.
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
    """Search for soft hinges; return the distinct ones, best first, with the mesh as it is."""
    search = search_of(problem, on_stage)
    rough = coarse_fit(problem, search, more)
    return fine_fit(problem, search, rough, stiffen_ridge(SOFT_RIDGE, misfit_of(problem, search, rough.motion)), more)


def coarse_fit(problem: Problem, search: Search, more: Energy) -> Solution[Soft[Fixed]]:
    """Run the coarse stages without an axis.

    If hypotheses are constrained to one too early, right poses whose motion is not quite a hinge lose.
    """
    energy = sum_energies(coarse_energy(problem), more)
    relaxed = search.relax(make_initial_poses(problem), energy)
    return search.coarse(replace(relaxed, ridge=COARSE_RIDGE), energy)


def fine_fit(
    problem: Problem, search: Search, rough: Solution[Soft[Fixed]], ridge: tuple[float, float], more: Energy
) -> Solution[Soft[Hinge]]:
    """Run the fine stages, with deviations as stiff as ``ridge``."""
    energy = sum_energies(coarse_energy(problem), more)
    return search.fine(soft_hinge_of(problem, search, rough, ridge), add_contact_consistency(problem, energy))


def fine_fit_with_hand(
    problem: Problem, search: Search, motion: M, energy: EnergyOf
) -> tuple[Solution[M], SolvedHand | None]:
    """Run the fine stages; before the last, a refined hand is solved together with the object."""
    if problem.refinement is None:
        return search.fine(motion, energy(problem)), None
    before = search.fine(motion, energy(problem), slice(-1)).motion
    hand, motion = solve_with_hand(problem, before, energy)
    search = replace(search, T_cam_hand=hand.T_cam_hand)
    return search.fine(motion, energy(problem.with_hand(hand)), slice(-1, None)), hand


def soft_hinge_of(
    problem: Problem, search: Search, rough: Solution[Soft[Fixed]], ridge: tuple[float, float]
) -> Soft[Hinge]:
    """Return the soft hinges nearest to what the coarse stages found, at all frames."""
    motion = search.at_all_frames(rough.motion)
    ridge = (problem.trust.firmness * ridge[0], problem.trust.firmness * ridge[1])
    return Soft.around(hinge_of(problem, motion), motion.poses(), ridge)


def misfit_of(problem: Problem, search: Search, rough: Soft[Fixed]) -> float:
    """Measure how badly the mesh explains the masks at its best.

    The fit is long enough, and without contact, so that nothing else adds to it.
    """
    frames = search.coarse_frames
    terms, T_cam_hand = mask_energy(problem)(MISFIT_LEVEL_PX, frames), problem.clip.hand.T_cam_hand[frames]
    fitted = minimise(rough, terms, T_cam_hand, MISFIT_ITERATIONS, threads=problem.threads)
    return relative_contour_error(problem.observation, float(fitted.terms["mask"].min()) / len(frames))


def fit_mesh_shape(problem: Problem, search: Search, rough: Soft[Fixed]) -> Warp | None:
    """Fit the mesh to the masks after the coarse stages; None where the mesh explains them."""
    return fit_shape(problem, rough, search.coarse_frames, misfit_of(problem, search, rough))


def soft_energy(problem: Problem) -> Energy:
    """Return the soft hinge's energy at all frames."""
    return add_contact_consistency(problem, coarse_energy(problem))


def one_dof(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a hinge (Eq. 3): ours, after the paper.

    ``methods.paper`` is the paper's method itself.

    The mesh is fitted by the same step as the soft hinge's, so that the two differ in the motion alone; but that takes
    its coarse stages, so it is left out where frames that deviate a little from the hinge explain the masks already.
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
    """Fit a pose per frame (paper, Sec. 5.2), by another energy if given."""
    energy_of = energy_of or contact_only_energy
    search, energy = search_of(problem, on_stage), energy_of(problem)
    relaxed = search.relax(make_initial_poses(problem), energy)
    shared = relaxed.poses()
    motion = Free(shared.R, shared.centre, relaxed.core.log_scale, relaxed.core.free_scale)
    return make_method_result(search.run(motion, energy), energy_of=energy_of)


def contact_only_energy(problem: Problem) -> Energy:
    """Return Eq. 5 where no other term links the object to the hand."""
    return total_energy(problem, CONTACT_ONLY_FACTOR)


def total_energy(problem: Problem, contact: float) -> Energy:
    """Return Eq. 5, with a multiple of the push and pull that the options name."""
    contact *= problem.trust.contact
    contacts = energy_of(problem, contact * problem.options.push, contact * problem.options.pull)
    return sum_energies(contacts, depth_order_energy(problem), category_energy(problem.clip))


def coarse_energy(problem: Problem) -> Energy:
    """Return the soft hinge's energy at some of the frames: Eq. 5."""
    return total_energy(problem, 1.0 if problem.options.pull else CONTACT_ONLY_FACTOR)


def add_contact_consistency(problem: Problem, energy: Energy) -> Energy:
    """Add contact that stays to an energy: the soft hinge's energy at all frames.

    Contact that stays is what makes a grasp stable (Eq. 2). A hinge keeps it by itself; where frames may deviate from
    the hinge, in depth above all, which silhouettes hardly show, a term keeps it.
    """
    pull = problem.trust.contact * problem.trust.firmness * problem.options.pull
    return (
        sum_energies(energy, distance_consistency_energy(problem, SOFT_HINGE_CONSISTENCY_WEIGHT * pull))
        if pull
        else energy
    )


def search_of(problem: Problem, on_stage: OnStage) -> Search:
    """Make the search on a clip, as long as the options say; longer beside a lifted hand, which tells little."""
    schedule = THOROUGH_SCHEDULE if problem.options.thorough or problem.trust.hand_lifted else DEFAULT_SCHEDULE
    opposite = handle_half_turns(problem.clip, problem.surface)
    return Search(problem.clip.hand.T_cam_hand, problem.surface, schedule, on_stage, problem.threads, opposite)


def make_initial_poses(problem: Problem) -> Fixed:
    """Return the initial poses, at all frames."""
    usual = category_rotations(problem.clip) if problem.options.init == "uniform" else None
    return initial_poses(problem.clip, problem.masks, problem.inits, problem.options.seed, problem.prior_poses, usual)


def hinge_of(problem: Problem, relaxed: Soft[Fixed]) -> Hinge:
    """Return the hinge nearest to a relaxed fit, its axis where the options allow it."""
    anywhere = problem.options.axis == "free"
    return Hinge.nearest(relaxed.core, relaxed.deviation, free_location=anywhere, anchor=np.zeros(3))


def make_method_result(
    found: Solution[M], hinge: Hinge | None = None, energy_of: EnergyOf | None = None
) -> MethodResult:
    """Return the solutions, and the axis of the best: that of ``hinge``, which is the motion or its core.

    ``energy_of`` is the energy by which the motion can be fitted in other frames; None: it cannot be.
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


CONTACT_CONSISTENCY_WEIGHT = 0.1
"""Weight of the term (``objective.consistency_of``): theirs is 1."""


def fit_contact_consistency(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit ``dynamic`` with one more term, in all stages. Raises ``GetagripError`` when nothing can be rendered."""
    return dynamic(problem, on_stage, total_energy_with_consistency)


def total_energy_with_consistency(problem: Problem) -> Energy:
    """Return Eq. 5 and the term."""
    return sum_energies(
        total_energy(problem, contact=1.0), distance_consistency_energy(problem, CONTACT_CONSISTENCY_WEIGHT)
    )
