"""HOMan (Hasson et al., "Towards Unconstrained Joint Hand-Object Reconstruction From RGB Videos", 3DV 2021).

In stages: the object alone, from its masks, in the first frame from many rotations, in each later frame from where the
frame before ended; the best tracks; then objects and hands together, with smoothness, interaction and contact
(``homan_refine``). What differs from the published code, and why, stands in docs/method.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.fitting.contact import farthest_point_sampling
from getagrip.fitting.energy import Energy
from getagrip.fitting.initial_poses import initial_poses
from getagrip.fitting.methods import OnStage, homan_refine
from getagrip.fitting.methods.homan_refine import RefinedTrack
from getagrip.fitting.motion import Fixed, Free, PosesInHand
from getagrip.fitting.objective import contact_energy, mask_energy
from getagrip.fitting.problem import EnergyOf, MethodResult, Problem
from getagrip.fitting.search import suppress_duplicates
from getagrip.fitting.solve import Solution, minimise
from getagrip.geometry import camera
from getagrip.result import Status

HOMAN_LEVEL_PX = 64
"""Resolution of the object's fit alone [px]."""
FIRST_FRAME_ITERATIONS, LATER_FRAME_ITERATIONS = 24, 12
"""Iterations of it: in the first frame, in each later one."""
N_REFINED_TRACKS = 4
"""Tracks that are refined; the published code takes the best one."""
N_BOX_POINTS = 64
"""Vertices that stand for the object where it is placed in a box."""


@dataclass(frozen=True)
class HomanSolver:
    """The energy and the optimiser of the stages."""

    contact: EnergyOf
    """Push and pull."""
    alone: Callable[[Problem, Fixed, int], Solution[Fixed]]
    """Fits the object to its mask in one frame, in the camera frame."""
    together: Callable[[Problem, Free, EnergyOf], RefinedTrack]
    """Refines a track of the object together with the hand."""
    badness: Callable[[Problem, Sequence[RefinedTrack]], Float[ndarray, "k"]]
    """Ranks refined tracks, the best lowest."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit by our energy and optimiser. Raises ``GetagripError`` when nothing can be rendered."""
    return fit_by_solver(OUR_HOMAN_SOLVER, problem, on_stage)


def fit_by_solver(way: HomanSolver, problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit the object alone, and refine the best tracks together with the hand.

    Raises ``GetagripError`` when nothing can be rendered.
    """
    tracks, loss = object_tracks(problem, way)
    chosen = suppress_duplicates(tracks.poses(), loss, problem.surface, N_REFINED_TRACKS)
    if not len(chosen):
        raise GetagripError(Status.INVISIBLE.sentence)
    on_stage("coarse")
    refined = [way.together(problem, tracks.take(chosen[k : k + 1]), way.contact) for k in range(len(chosen))]
    energy = np.array([r.energy for r in refined])
    poses = reduce(PosesInHand.concatenate, [r.bodies.in_hand() for r in refined])
    score = np.where(np.isfinite(energy), way.badness(problem, refined), np.inf)
    best = suppress_duplicates(poses, score, problem.surface, N_REFINED_TRACKS)
    if not len(best):
        raise GetagripError(Status.INVISIBLE.sentence)
    on_stage("finest")
    first = refined[best[0]]
    return MethodResult(poses.take(best), energy[best], first.terms, first.status)


def _fit_object_in_frame(problem: Problem, start: Fixed, n: int) -> Solution[Fixed]:
    terms = mask_energy(problem)(HOMAN_LEVEL_PX, np.array([n]))
    return minimise(start, terms, np.eye(4)[None], LATER_FRAME_ITERATIONS if n else FIRST_FRAME_ITERATIONS)


def _contact_energy(problem: Problem) -> Energy:
    return contact_energy(problem, problem.options.push, problem.options.pull)


OUR_HOMAN_SOLVER = HomanSolver(
    contact=_contact_energy,
    alone=_fit_object_in_frame,
    together=homan_refine.refine_track,
    badness=lambda _, refined: np.array([r.energy for r in refined]),
)


def object_tracks(problem: Problem, way: HomanSolver = OUR_HOMAN_SOLVER) -> tuple[Free, Float[ndarray, "B"]]:
    """Track the object in the camera frame from each starting rotation, by E_mask alone.

    The second value is the mean of E_mask / area.
    """
    clip, area = problem.clip, problem.observation.area
    initial = initial_poses(clip, problem.masks, problem.inits, problem.options.seed, problem.prior_poses)
    vertices = clip.mesh.vertices - clip.mesh.centre
    points = np.exp(initial.log_scale[0]) * vertices[farthest_point_sampling(vertices, N_BOX_POINTS)]
    boxes = camera.bounding_boxes(problem.masks.object).astype(float)
    R = clip.hand.T_cam_hand[0, :3, :3] @ initial.R
    rotations, centres, loss = [], [], np.zeros(len(R))
    for n, K in enumerate(clip.K):
        start = Fixed(R, place_in_box(R, points, K, boxes[n]), initial.log_scale, frames=1)
        found = way.alone(problem, start, n)
        R = found.motion.R
        rotations.append(R)
        centres.append(found.motion.centre)
        loss += found.energy / (area[n] * len(clip))
    free = clip.scale == "free"
    return Free(np.stack(rotations, axis=1), np.stack(centres, axis=1), initial.log_scale, free), loss


def place_in_box(
    R: Float[ndarray, "B 3 3"],
    points: Float[ndarray, "P 3"],
    K: Float[ndarray, "3 3"],
    box: Float[ndarray, "4"],
    steps: int = 10,
) -> Float[ndarray, "B 3"]:
    """Place rotated points [m] so that the box around them has the centre and diagonal of a given box.

    A fixed point, as in the published code: depth times the ratio of diagonals, then along the ray through the box's
    centre by what is left.
    """
    placed = points @ np.swapaxes(R, -1, -2)
    middle, diagonal = (box[:2] + box[2:]) / 2.0, np.linalg.norm(box[2:] - box[:2])
    ray = camera.backproject(K, middle[None])[0]
    centre = np.tile(ray, (len(R), 1))
    for _ in range(steps):
        uv = camera.project(K, placed + centre[:, None])
        low, high = uv.min(axis=1), uv.max(axis=1)
        depth = centre[:, 2] * np.linalg.norm(high - low, axis=1) / diagonal
        off = middle - (low + high) / 2.0
        shift = off * centre[:, 2:] / K[[0, 1], [0, 1]]
        centre[:, :2] = (centre[:, :2] + shift) * (depth / centre[:, 2])[:, None]
        centre[:, 2] = np.maximum(depth, 2.0 * np.abs(placed[..., 2]).max(axis=1))
    return centre
