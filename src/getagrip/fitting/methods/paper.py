"""The paper's method, and our departures from it, which can be made one by one (``Departures``).

Eq. 5 with the paper's weights, on our silhouettes (their values are exact; the gradient of E_mask is smoothed below a
pixel, and stands for the hand-crafted one of the paper's renderer): E_mask is the number of wrong pixels at 256 x 256;
push and pull are those of the appendix, in metres, times 0.1 f, f the focal length in pixels of the crop. The latent
axis starts as the CAD's z-axis through its origin, angles at zero; every initial pose runs to its end on all frames;
the best IOU wins.

The paper leaves these open, or its numbers rule out what is printed (docs/method.md says what was tried):

- the unit of push and pull: metres, as in the authors' later code. The printed millimetres are 1000 times the weights;
- the height in E_pull: absolute, of the pair of least distance (``PaperPullTerm``), as in the authors' later code;
- the optimiser: Adam, as in the authors' later code (``adam``), with ``ITERATIONS`` and ``RATE``;
- how the object's vertices, of whose number E_push depends, are spread: those of the mesh decimated to 1000 faces,
  about as many as the authors' meshes have;
- where the axis lies: it has a location (``Options.axis``), as in the authors' code;
- initial poses: those of all our methods (``initial_poses``), or the paper's alone, from files.

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
from getagrip.fitting import adam, solve
from getagrip.fitting.contact import HandContacts
from getagrip.fitting.energy import Energy, PosesInCamera
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.fitting.energy.paper_pull import PaperPullTerm
from getagrip.fitting.energy.paper_push import PaperPushTerm, TangentPlanes
from getagrip.fitting.methods import OnStage
from getagrip.fitting.methods import homan as homans
from getagrip.fitting.methods import single_frame as single_frames
from getagrip.fitting.methods.all_frames import ALONE, hinge_of, initial_of, result_of, search_of
from getagrip.fitting.methods.homan_refine import Refined, bodies_of, descend_by_adam, joint_energy
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion
from getagrip.fitting.objective import CONTACTS, NOTHING, contact_weights, mask_of, plus, pull_of, push_of
from getagrip.fitting.observation import CROP
from getagrip.fitting.problem import EnergyOf, MethodResult, Problem
from getagrip.fitting.search import suppress_duplicates
from getagrip.fitting.solve import Solution, in_camera
from getagrip.kernels.silhouette import silhouettes
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

ITERATIONS = 200
"""Iterations of Adam; for Levenberg-Marquardt, which stops by itself, the limit."""
RATE = 0.05
"""Adam's, at the start [rad a step], falling to zero. Of 0.01 with 50 iterations (the authors'), and 0.03, 0.05 and 0.1
with 100 to 200, this ends at the truth most often where the truth is among the starts (synthetic mugs and bottles).
From uniform starts (four training clips of DexYCB) 150 iterations of it end with up to 4 % more energy than 200 from
0.1."""
ALONE_ITERATIONS = 50
"""HOMan's, of the object alone in each frame: those of its published code."""
KEEP = 4
"""Distinct solutions that are kept."""
PARTS = ("first quarter", "second quarter", "third quarter", "last quarter")
"""Stages: of the initial poses."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit a hinge (Eq. 3), with the departures that the options name."""
    return hinge(problem, on_stage, energy_of(problem))


def hinge(problem: Problem, on_stage: OnStage, energy: Energy) -> MethodResult:
    """Fit a hinge (Eq. 3) by an energy, with the departures that the options name."""
    ours = problem.options.departures
    search, initial = search_of(problem, on_stage), initial_of(problem)
    if ours.axis:
        start = hinge_of(problem, search.relax(initial, energy))
    else:
        start = search.at_first_frames(about_z(initial, problem.clip.mesh.centre, problem.options.axis == "free"))
    if ours.search:
        found = search.run(start, energy)
    else:
        found = every_start(problem, search.at_all_frames(start, 0), energy, on_stage)
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


def single_frame(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit every frame on its own (paper, Sec. 5.2). Raises ``GetagripError`` where nothing can be rendered."""

    def best_of_frame(problem: Problem, n: int, energy: Energy) -> Solution[Fixed]:
        here = np.array([n])
        found = every_start(problem, single_frames.initial_of_frame(problem, n), energy, lambda _: None, here)
        return chosen(problem, found, here)

    def again(problem: Problem, n: int, energy: Energy, start: Fixed) -> Solution[Fixed]:
        return every_start(problem, start, energy, lambda _: None, np.array([n]))

    return single_frames.of_frames(problem, on_stage, energy_of(problem), best_of_frame, again)


def homan(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit HOMan (``homan``) with the paper's push and pull, by Adam; the best IOU wins.

    Raises ``GetagripError`` where nothing can be rendered.
    """

    def alone(problem: Problem, start: Fixed, n: int) -> Solution[Fixed]:
        return adam.descend(start, mask_of(problem)(CROP, np.array([n])), np.eye(4)[None], ALONE_ITERATIONS, RATE)

    def together(problem: Problem, track: Free, contact: EnergyOf) -> Refined:
        bodies = bodies_of(problem, track)
        energy = joint_energy(problem, CROP, bodies, contact)
        return descend_by_adam(energy, bodies, ITERATIONS, RATE, track.free_scale)

    def badness(problem: Problem, refined: Sequence[Refined]) -> Float[ndarray, "k"]:
        return np.array([-crop_iou(problem, one.bodies.in_camera())[0] for one in refined])

    return homans.by(homans.Way(contact_of, alone, together, badness), problem, on_stage)


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
    """Return Eq. 5, with the departures that the options name."""
    return plus(mask_of(problem), contact_of(problem))


def contact_of(problem: Problem) -> Energy:
    """Return push and pull of the appendix, with the departures that the options name; weight 0 leaves a term out."""
    ours, options = problem.options.departures, problem.options
    if ours.scale:
        push, pull = contact_weights(problem, ALONE * options.push, ALONE * options.pull)
        push = push if ours.push else push / len(problem.surface.coarse.vertices)  # a mean instead of the sum
    else:
        push, pull = (weight * problem.observation.K[:, 0] for weight in (options.push, options.pull))
    return plus(
        (push_of if ours.push else paper_push_of)(problem, push) if options.push else NOTHING,
        (pull_of if ours.pull else paper_pull_of)(problem, pull) if options.pull else NOTHING,
    )


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


def every_start(
    problem: Problem, motion: M, energy: Energy, on_stage: OnStage, frames: Int[ndarray, "n"] | None = None
) -> Solution[M]:
    """Fit every hypothesis to its end, on all frames or on the given ones, at 256 pixels."""
    frames = np.arange(len(problem.clip)) if frames is None else frames
    T, terms = problem.clip.hand.T_cam_hand[frames], energy(CROP, frames)
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


def chosen(problem: Problem, found: Solution[M], frames: Int[ndarray, "n"] | None = None) -> Solution[M]:
    """Choose distinct solutions of all frames or of the given ones, best first: by IOU, or by energy.

    Raises ``GetagripError`` where nothing was rendered.
    """
    frames = np.arange(len(problem.clip)) if frames is None else frames
    score = found.energy
    if not problem.options.departures.choice:
        poses = in_camera(found.motion, problem.clip.hand.T_cam_hand[frames])
        score = np.where(np.isfinite(score), -crop_iou(problem, poses, frames), np.inf)
    best = suppress_duplicates(found.motion.poses(), score, problem.surface, KEEP)
    if not len(best):
        raise GetagripError(Status.INVISIBLE.sentence)
    return found.take(best)


def crop_iou(
    problem: Problem, poses: PosesInCamera, frames: Int[ndarray, "n"] | slice = slice(None)
) -> Float[ndarray, "B"]:
    """Compute the mean IOU of rendered and observed masks over the frames, in the crops, outside hidden pixels."""
    observation, clip = problem.observation, problem.clip
    tables = SilhouetteMesh.of(clip.mesh, clip.mesh.centre).tables
    K, observed, valid = observation.K[frames], observation.observed[CROP][frames], observation.valid[CROP][frames]
    rendered, iou = np.empty_like(observed), []
    for R, centre, scale in zip(poses.R, poses.centre, poses.scale, strict=True):
        silhouettes(R, centre, np.full(len(K), scale), *tables, K, rendered)
        both = np.bitwise_count(rendered & observed).sum(axis=(1, 2))
        either = np.bitwise_count(rendered & valid | observed).sum(axis=(1, 2))
        iou.append(np.mean(both / np.maximum(either, 1)))
    return np.array(iou)
