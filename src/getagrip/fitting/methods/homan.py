"""HOMan (Hasson et al., "Towards Unconstrained Joint Hand-Object Reconstruction From RGB Videos", 3DV 2021).

In stages: the object alone, from its masks, in the first frame from many rotations, in each later frame from where the
frame before ended; the best tracks; then objects and hands together, with smoothness, interaction and contact
(``homan_joint``). What differs from the published code, and why, is told in docs/method.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.fitting.contact import spread_points
from getagrip.fitting.initial_poses import starting_poses
from getagrip.fitting.methods import homan_refine as homan_joint
from getagrip.fitting.motion import Fixed, Free
from getagrip.fitting.objective import energy_of
from getagrip.fitting.problem import Found, Problem
from getagrip.fitting.search import Stage, distinct
from getagrip.fitting.solve import Status, minimise
from getagrip.geometry import camera

FIRST = Stage("coarse", level=64, frames=1, iterations=24, keep=0)
LATER = Stage("coarse", level=64, frames=1, iterations=12, keep=0)
"""The object alone: in the first frame, in each later one."""
TRACKS = 4
"""Tracks that are refined; the published code takes the best one."""
OUTLINE = 64
"""Vertices that stand for the object where it is placed in a box."""


def fit(problem: Problem, watch: Callable[[str], None]) -> Found:
    """The best track of the object alone, refined together with the hand.

    ``watch`` is told the name of a stage when it ends. Raises ``GetagripError`` when nothing can be rendered.
    """
    centre = problem.clip.mesh.centre
    tracks, loss = object_tracks(problem)
    chosen = distinct(tracks.poses(), loss, problem.shape, TRACKS)
    watch("coarse")
    refined = [homan_joint.refine(problem, tracks.take(chosen[k : k + 1])) for k in range(len(chosen))]
    refined = sorted((r for r in refined if np.isfinite(r.energy)), key=lambda r: r.energy)
    if not refined:
        raise GetagripError(str(Status.INVISIBLE))
    watch("finest")
    scale = np.array([r.bodies.scale for r in refined])
    T = np.stack([r.bodies.T_hand_obj(centre) for r in refined])
    return Found(T, scale, np.array([r.energy for r in refined]), refined[0].terms, refined[0].status.value)


def object_tracks(problem: Problem) -> tuple[Free, Float[ndarray, "B"]]:
    """The object in the camera frame from each starting rotation, by E_mask alone, and the mean of E_mask / area."""
    clip, area = problem.clip, problem.observation.area
    mask_only = energy_of(problem, push=0.0, pull=0.0)
    starts = starting_poses(clip, problem.masks, problem.options.inits, problem.options.seed, problem.poses)
    vertices = clip.mesh.vertices - clip.mesh.centre
    outline = np.exp(starts.log_scale[0]) * vertices[spread_points(vertices, OUTLINE)]
    boxes = camera.bounding_boxes(problem.masks.object).astype(float)
    R = clip.hand.T_cam_hand[0, :3, :3] @ starts.R
    rotations, centres, loss = [], [], np.zeros(len(R))
    for n, K in enumerate(clip.K):
        start = Fixed(R, in_box(R, outline, K, boxes[n]), starts.log_scale, frames=1)
        stage = LATER if n else FIRST
        found = minimise(start, mask_only(stage, np.array([n])), np.eye(4)[None], stage.iterations)
        R = found.motion.R
        rotations.append(R)
        centres.append(found.motion.centre)
        loss += found.energy / (area[n] * len(clip))
    free = clip.scale == "free"
    return Free(np.stack(rotations, axis=1), np.stack(centres, axis=1), starts.log_scale, free), loss


def in_box(
    R: Float[ndarray, "B 3 3"],
    points: Float[ndarray, "P 3"],
    K: Float[ndarray, "3 3"],
    seen: Float[ndarray, "4"],
    steps: int = 10,
) -> Float[ndarray, "B 3"]:
    """Where turned points must stand [m] for the box around them to have the centre and diagonal of the box seen.

    A fixed point, as in the published code: depth times the ratio of diagonals, then along the ray through the box's
    centre by what is left.
    """
    placed = points @ np.swapaxes(R, -1, -2)
    middle, diagonal = (seen[:2] + seen[2:]) / 2.0, np.linalg.norm(seen[2:] - seen[:2])
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
