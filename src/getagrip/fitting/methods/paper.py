"""The paper's method, and our departures from it, which can be switched one by one (``Departures``).

Eq. 5 with the paper's weights, on our silhouettes (their values are exact; the gradient of E_mask is smoothed below a
pixel, and stands for the hand-crafted one of the paper's renderer): E_mask is the number of wrong pixels at 256 x 256;
push and pull are those of the appendix, in metres, times 0.1 f, f the focal length in pixels of the crop. The latent
axis starts as the CAD's z-axis through its origin, angles at zero; every initial pose runs to its end on all frames;
the best IOU wins.

The paper leaves these choices open, or its numbers contradict the printed ones (docs/method-details.md has both):

- the unit of push and pull: metres, as in the authors' later code. The printed millimetres are 1000 times the weights;
- the height in E_pull: absolute, of the pair of least distance (``PaperPullTerm``), as in the authors' later code;
- the optimiser: Adam, as in the authors' later code, with ``PAPER_ITERATIONS`` and ``PAPER_LEARNING_RATE``;
- the object's vertices, on whose number E_push depends: the vertices of the mesh decimated to 1000 faces, about as
  many as the authors' meshes have;
- the axis's location: it is a parameter (``Options.axis``), as in the authors' code;
- initial poses: our methods' (``initial_poses``), or the paper's alone, from files.

The paper's baselines are fitted by the same energy, optimiser and choice: ``static``, ``dynamic``, ``single_frame`` and
``homan``, whose joint stage adds its own terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.fitting.energy import Energy, PosesInCamera
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX, SilhouetteMesh
from getagrip.fitting.energy.paper_contact import PaperPullTerm, PaperPushTerm, TangentPlanes
from getagrip.fitting.methods import OnStage
from getagrip.fitting.methods.all_frames import (
    CONTACT_ONLY_FACTOR,
    hinge_of,
    make_initial_poses,
    make_method_result,
    search_of,
)
from getagrip.fitting.methods.homan import (
    HomanSolver,
    RefinedTrack,
    fit_by_solver,
    joint_energy,
    make_rigid_bodies,
    refine_by_adam,
)
from getagrip.fitting.methods.single_frame import fit_each_frame, initial_of_frame
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion
from getagrip.fitting.objective import (
    NO_TERMS,
    contact_weights,
    mask_energy,
    pull_energy,
    push_energy,
    sum_energies,
)
from getagrip.fitting.problem import N_REGION_CONTACTS, EnergyOf, MethodResult, Problem
from getagrip.fitting.solver.search import suppress_duplicates
from getagrip.fitting.solver.solve import Solution, minimise, minimise_by_adam, poses_in_camera
from getagrip.geometry.kernels.silhouette import silhouettes
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

PAPER_ITERATIONS = 200
"""Iterations of Adam; for Levenberg-Marquardt, which stops by itself, the limit."""
PAPER_LEARNING_RATE = 0.05
"""Adam's initial step [rad], which falls to zero. Of 0.01 with 50 iterations (the authors'), and 0.03, 0.05 and 0.1
with 100 to 200, this step ends at the truth most often where the truth is an initial pose (synthetic mugs and bottles).
From uniform initial poses (four training clips of DexYCB) 150 iterations of it end with up to 4 % more energy than 200
from 0.1."""
OBJECT_ONLY_ITERATIONS = 50
"""Iterations of HOMan's fit of the object alone in each frame, as in its published code."""
N_DISTINCT_SOLUTIONS = 4
"""Number of distinct solutions that are kept."""
START_QUARTERS = ("first quarter", "second quarter", "third quarter", "last quarter")
"""Stages: quarters of the initial poses."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a hinge (Eq. 3), with the departures that the options name."""
    return hinge(problem, on_stage, paper_energy(problem))


def hinge(problem: Problem, on_stage: OnStage, energy: Energy) -> MethodResult:
    """Fit a hinge (Eq. 3) by an energy, with the departures that the options name."""
    ours = problem.options.departures
    search, initial = search_of(problem, on_stage), make_initial_poses(problem)
    if ours.axis:
        start = hinge_of(problem, search.relax(initial, energy))
    else:
        start = search.at_first_frames(hinge_about_z(initial, problem.clip.mesh.centre, problem.options.axis == "free"))
    if ours.search:
        found = search.run(start, energy)
    else:
        found = fit_every_start(problem, search.at_all_frames(start, 0), energy, on_stage)
    found = choose_solutions(problem, found)
    return make_method_result(found, found.motion, paper_energy)


def static(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit one pose for all frames (paper, Sec. 5.2)."""
    found = fit_every_start(problem, make_initial_poses(problem), paper_energy(problem), on_stage)
    return make_method_result(choose_solutions(problem, found))


def dynamic(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a pose per frame (paper, Sec. 5.2), the same in all frames to begin with."""
    initial = make_initial_poses(problem)
    start = initial.poses()
    motion = Free(start.R.copy(), start.centre.copy(), initial.log_scale, initial.free_scale)
    found = choose_solutions(problem, fit_every_start(problem, motion, paper_energy(problem), on_stage))
    return make_method_result(found, energy_of=paper_energy)


def single_frame(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit every frame independently (paper, Sec. 5.2). Raises ``GetagripError`` where no pose can be rendered."""

    def best_of_frame(problem: Problem, n: int, energy: Energy) -> Solution[Fixed]:
        here = np.array([n])
        found = fit_every_start(problem, initial_of_frame(problem, n), energy, lambda _: None, here)
        return choose_solutions(problem, found, here)

    def again(problem: Problem, n: int, energy: Energy, start: Fixed) -> Solution[Fixed]:
        return fit_every_start(problem, start, energy, lambda _: None, np.array([n]))

    return fit_each_frame(problem, on_stage, paper_energy(problem), best_of_frame, again)


def homan(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit HOMan (``homan``) with the paper's push and pull, by Adam; the best IOU wins.

    Raises ``GetagripError`` where no pose can be rendered.
    """

    def alone(problem: Problem, start: Fixed, n: int) -> Solution[Fixed]:
        terms = mask_energy(problem)(MASK_CROP_SIZE_PX, np.array([n]))
        return minimise_by_adam(start, terms, np.eye(4)[None], OBJECT_ONLY_ITERATIONS, PAPER_LEARNING_RATE)

    def together(problem: Problem, track: Free, contact: EnergyOf) -> RefinedTrack:
        bodies = make_rigid_bodies(problem, track)
        energy = joint_energy(problem, MASK_CROP_SIZE_PX, bodies, contact)
        return refine_by_adam(energy, bodies, PAPER_ITERATIONS, PAPER_LEARNING_RATE, track.free_scale)

    def badness(problem: Problem, refined: Sequence[RefinedTrack]) -> Float[ndarray, "k"]:
        return np.array([-crop_iou(problem, one.bodies.in_camera())[0] for one in refined])

    return fit_by_solver(HomanSolver(paper_contact_energy, alone, together, badness), problem, on_stage)


def hinge_about_z(initial: Fixed, centre: Float[ndarray, "3"], anywhere: bool = True) -> Hinge:
    """Make the paper's initial hinges: about the CAD's z-axis through its origin, or the hand's, all angles zero.

    ``centre`` is the mesh's centre in its own frame.
    """
    origin = -np.exp(initial.log_scale)[:, None] * centre
    point = initial.centre + (initial.R @ origin[..., None])[..., 0]
    return Hinge(
        initial.R, initial.centre, initial.log_scale,
        point=point if anywhere else np.zeros_like(point),
        direction=initial.R[:, :, 2].copy(),
        angle=np.zeros((len(initial.R), initial.frames)),
        free_scale=initial.free_scale, free_location=anywhere,
    )  # fmt: skip


def paper_energy(problem: Problem) -> Energy:
    """Return Eq. 5, with the departures that the options name."""
    return sum_energies(mask_energy(problem), paper_contact_energy(problem))


def paper_contact_energy(problem: Problem) -> Energy:
    """Return push and pull of the appendix, with the departures that the options name; weight 0 leaves a term out."""
    ours, options = problem.options.departures, problem.options
    if ours.scale:
        push, pull = contact_weights(problem, CONTACT_ONLY_FACTOR * options.push, CONTACT_ONLY_FACTOR * options.pull)
        push = push if ours.push else push / len(problem.surface.coarse.vertices)  # a mean instead of the sum
    else:
        push, pull = (weight * problem.observation.K[:, 0] for weight in (options.push, options.pull))
    return sum_energies(
        (push_energy if ours.push else paper_push_of)(problem, push) if options.push else NO_TERMS,
        (pull_energy if ours.pull else paper_pull_of)(problem, pull) if options.pull else NO_TERMS,
    )


def paper_push_of(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return E_push of the appendix, by its weight in each frame [px^2 / m]."""
    vertices, _ = _centred_vertices_and_normals(problem)
    planes = {level: TangentPlanes.of(problem.clip.hand, count) for level, count in N_REGION_CONTACTS.items()}
    return lambda level, index: [PaperPushTerm(vertices, planes[level].take(index), weight[index])]


def paper_pull_of(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return E_pull of the appendix, by its weight in each frame [px^2 / m]."""
    surface = _centred_vertices_and_normals(problem)
    hands = problem.contacts
    return lambda level, index: [PaperPullTerm(*surface, hands[level].take(index), weight[index])]


def _centred_vertices_and_normals(problem: Problem) -> tuple[Float[ndarray, "3 V"], Float[ndarray, "3 V"]]:
    """Return the decimated object's vertices about its centre, and their normals."""
    mesh = problem.surface.coarse
    about = mesh.vertices - problem.clip.mesh.centre
    return np.ascontiguousarray(about.T), np.ascontiguousarray(mesh.normals.T)


def fit_every_start(
    problem: Problem, motion: M, energy: Energy, on_stage: OnStage, frames: Int[ndarray, "n"] | None = None
) -> Solution[M]:
    """Fit every hypothesis to its end, on all frames or on ``frames``, at 256 pixels."""
    frames = np.arange(len(problem.clip)) if frames is None else frames
    T, terms = problem.clip.hand.T_cam_hand[frames], energy(MASK_CROP_SIZE_PX, frames)
    parts = []
    quarters = np.array_split(np.arange(len(motion.poses().scale)), len(START_QUARTERS))
    for name, rows in zip(START_QUARTERS, quarters, strict=True):
        if len(rows):
            some = motion.take(rows)
            if problem.options.departures.optimiser:
                parts.append(minimise(some, terms, T, PAPER_ITERATIONS, threads=problem.threads))
            else:
                parts.append(minimise_by_adam(some, terms, T, PAPER_ITERATIONS, PAPER_LEARNING_RATE))
        on_stage(name)
    return reduce(lambda found, more: found.concatenate(more), parts)


def choose_solutions(problem: Problem, found: Solution[M], frames: Int[ndarray, "n"] | None = None) -> Solution[M]:
    """Choose distinct solutions of all frames or of ``frames``, best first: by IOU, or by energy.

    Raises ``GetagripError`` where no pose was rendered.
    """
    frames = np.arange(len(problem.clip)) if frames is None else frames
    score = found.energy
    if not problem.options.departures.choice:
        poses = poses_in_camera(found.motion, problem.clip.hand.T_cam_hand[frames])
        score = np.where(np.isfinite(score), -crop_iou(problem, poses, frames), np.inf)
    best = suppress_duplicates(found.motion.poses(), score, problem.surface, N_DISTINCT_SOLUTIONS)
    if not len(best):
        raise GetagripError(Status.INVISIBLE.sentence)
    return found.take(best)


def crop_iou(
    problem: Problem, poses: PosesInCamera, frames: Int[ndarray, "n"] | slice = slice(None)
) -> Float[ndarray, "B"]:
    """Compute the mean IOU of rendered and observed masks over the frames, in the crops, outside hidden pixels."""
    observation, clip = problem.observation, problem.clip
    tables = SilhouetteMesh.of(clip.mesh, clip.mesh.centre).tables
    bits = observation.observed, observation.valid
    K, (observed, valid) = observation.K[frames], (masks[MASK_CROP_SIZE_PX][frames] for masks in bits)
    rendered, iou = np.empty_like(observed), []
    for R, centre, scale in zip(poses.R, poses.centre, poses.scale, strict=True):
        silhouettes(R, centre, np.full(len(K), scale), *tables, K, rendered)
        both = np.bitwise_count(rendered & observed).sum(axis=(1, 2))
        either = np.bitwise_count(rendered & valid | observed).sum(axis=(1, 2))
        iou.append(np.mean(both / np.maximum(either, 1)))
    return np.array(iou)
