"""The paper's method to the letter, and our departures from it, which can be made one by one (``Departures``).

Eq. 5 with the paper's weights, on our silhouettes (their values are exact; the gradient of E_mask is smoothed below a
pixel, and stands for the hand-crafted one of the paper's renderer): E_mask is the number of wrong pixels at 256 x 256;
push and pull are those of the appendix, in millimetres, times 0.1 f, f the focal length in pixels of the crop. The
latent axis starts as the CAD's z-axis through its origin, angles at zero;
every initial pose runs to its end on all frames; the best IOU wins.

The paper leaves these open:

- the optimiser: Adam, as in the authors' later code (``adam``), with ``ITERATIONS`` and ``RATE``;
- how the object's vertices, of whose number E_push depends, are spread: those of the mesh decimated to 1000 faces,
  about as many as the authors' meshes have;
- where the axis lies: it has a location (``Options.axis``), as in the authors' code;
- which pair E_pull means: that of least distance (``PaperPullTerm``), as the paper says and the authors' code has it;
- initial poses: those of all our methods (``initial_poses``), or the paper's alone, from files.
"""

from __future__ import annotations

from functools import reduce
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.fitting import adam, solve
from getagrip.fitting.contact import HandContacts
from getagrip.fitting.energy import Energy
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.fitting.energy.paper_pull import PaperPullTerm
from getagrip.fitting.energy.paper_push import PaperPushTerm, TangentPlanes
from getagrip.fitting.methods import OnStage
from getagrip.fitting.methods.all_frames import ALONE, hinge_of, initial_of, result_of, search_of
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion
from getagrip.fitting.objective import CONTACTS, contact_weights, mask_of, plus, pull_of, push_of
from getagrip.fitting.observation import CROP
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.search import suppress_duplicates
from getagrip.fitting.solve import Solution, in_camera
from getagrip.kernels.silhouette import silhouettes
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

ITERATIONS = 200
"""Iterations of Adam; for Levenberg-Marquardt, which stops by itself, the limit."""
RATE = 0.1
"""Adam's, at the start [rad a step]: of 0.01 (the authors'), 0.03, 0.1 and 0.2 the one of least energy on five clips of
the synthetic training split."""
KEEP = 4
"""Distinct solutions that are kept."""
PARTS = ("first quarter", "second quarter", "third quarter", "last quarter")
"""Stages: of the initial poses."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a hinge (Eq. 3), with the departures that the options name."""
    ours = problem.options.departures
    search, energy, initial = search_of(problem, on_stage), energy_of(problem), initial_of(problem)
    if ours.axis:
        hinge = hinge_of(problem, search.relax(initial, energy))
    else:
        hinge = search.at_first_frames(about_z(initial, problem.clip.mesh.centre, problem.options.axis == "free"))
    if ours.search:
        found = search.run(hinge, energy)
    else:
        found = every_start(problem, search.at_all_frames(hinge, 0), energy, on_stage)
    found = chosen(problem, found)
    return result_of(found, found.motion, energy_of)


def static(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit one pose for all frames (paper, Sec. 5.2)."""
    return result_of(chosen(problem, every_start(problem, initial_of(problem), energy_of(problem), on_stage)))


def dynamic(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a pose per frame (paper, Sec. 5.2), the same in all frames to begin with."""
    initial = initial_of(problem)
    start = initial.poses()
    motion = Free(start.R.copy(), start.centre.copy(), initial.log_scale, initial.free_scale)
    found = chosen(problem, every_start(problem, motion, energy_of(problem), on_stage))
    return result_of(found, energy_of=energy_of)


def about_z(initial: Fixed, centre: Float[ndarray, "3"], anywhere: bool = True) -> Hinge:
    """Make the paper's start: about the CAD's z-axis through its origin, or the hand's, all angles zero.

    ``centre`` is the mesh's, in its own frame.
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


def energy_of(problem: Problem) -> Energy:
    """Return Eq. 5 to the letter, but for the departures that the options name."""
    ours, options = problem.options.departures, problem.options
    if ours.scale:
        push, pull = contact_weights(problem, ALONE * options.push, ALONE * options.pull)
    else:
        push, pull = (1e3 * weight * problem.observation.K[:, 0] for weight in (options.push, options.pull))
    vertices = len(problem.surface.coarse.vertices) if ours.scale else 1  # a mean, or the sum
    pushed = push_of(problem, push) if ours.push else paper_push_of(problem, push / vertices)
    # The paper's pull, which may be negative, stands first (``PaperPullTerm``).
    mask = mask_of(problem)
    return plus(mask, pushed, pull_of(problem, pull)) if ours.pull else plus(paper_pull_of(problem, pull), mask, pushed)


def paper_push_of(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return E_push of the appendix, by its weight in each frame [px^2 / m]."""
    vertices, _ = _surface(problem)
    planes = {level: TangentPlanes.of(problem.clip.hand, count) for level, count in CONTACTS.items()}
    return lambda level, index: [PaperPushTerm(vertices, planes[level].take(index), weight[index])]


def paper_pull_of(problem: Problem, weight: Float[ndarray, "N"]) -> Energy:
    """Return E_pull of the appendix, by its weight in each frame [px^2 / m]."""
    surface = _surface(problem)
    hands = {level: HandContacts.of(problem.clip.hand, count) for level, count in CONTACTS.items()}
    return lambda level, index: [PaperPullTerm(*surface, hands[level].take(index), weight[index])]


def _surface(problem: Problem) -> tuple[Float[ndarray, "3 V"], Float[ndarray, "3 V"]]:
    """Return the decimated object's vertices about its centre, and its normals there."""
    mesh = problem.surface.coarse
    about = mesh.vertices - problem.clip.mesh.centre
    return np.ascontiguousarray(about.T), np.ascontiguousarray(mesh.normals.T)


def every_start(problem: Problem, motion: M, energy: Energy, on_stage: OnStage) -> Solution[M]:
    """Fit every hypothesis to its end, on all frames at 256 pixels."""
    T = problem.clip.hand.T_cam_hand
    terms = energy(CROP, np.arange(len(T)))
    parts = []
    for name, rows in zip(PARTS, np.array_split(np.arange(len(motion.poses().scale)), len(PARTS)), strict=True):
        if len(rows):
            some = motion.take(rows)
            if problem.options.departures.optimiser:
                parts.append(solve.minimise(some, terms, T, ITERATIONS, threads=problem.threads))
            else:
                parts.append(adam.descend(some, terms, T, ITERATIONS, RATE))
        on_stage(name)
    return reduce(lambda found, more: found.concatenate(more), parts)


def chosen(problem: Problem, found: Solution[M]) -> Solution[M]:
    """Choose distinct solutions, best first: by IOU, or by energy.

    Raises ``GetagripError`` where nothing was rendered.
    """
    score = found.energy
    if not problem.options.departures.choice:
        score = np.where(np.isfinite(score), -crop_iou(problem, found.motion), np.inf)
    best = suppress_duplicates(found.motion.poses(), score, problem.surface, KEEP)
    if not len(best):
        raise GetagripError(Status.INVISIBLE.sentence)
    return found.take(best)


def crop_iou(problem: Problem, motion: Motion) -> Float[ndarray, "B"]:
    """Compute the mean IOU of rendered and observed masks over the frames, in the crops, outside hidden pixels."""
    observation, clip = problem.observation, problem.clip
    poses = in_camera(motion, clip.hand.T_cam_hand)
    tables = SilhouetteMesh.of(clip.mesh, clip.mesh.centre).tables
    observed, valid = observation.observed[CROP], observation.valid[CROP]
    rendered, iou = np.empty_like(observed), []
    for R, centre, scale in zip(poses.R, poses.centre, poses.scale, strict=True):
        silhouettes(R, centre, np.full(len(clip), scale), *tables, observation.K, rendered)
        both = np.bitwise_count(rendered & observed).sum(axis=(1, 2))
        either = np.bitwise_count(rendered & valid | observed).sum(axis=(1, 2))
        iou.append(np.mean(both / np.maximum(either, 1)))
    return np.array(iou)
