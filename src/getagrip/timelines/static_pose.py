"""The pose of a static object: one pose in the world for all frames of the segment, from the masks alone.

No hand helps and none disturbs. A camera that stands still sees one silhouette only, through hands that pass: depth
comes from the object's size, and from the plane that it lies on where that is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.clip.sampling import frame_indices
from getagrip.fitting.energy import Energy, PosesInCamera, Quadratic, Term
from getagrip.fitting.motion import Fixed
from getagrip.fitting.objective import object_evidence_energy, sum_energies
from getagrip.fitting.problem import Problem
from getagrip.fitting.schedule import DEFAULT_SCHEDULE
from getagrip.fitting.search import Search
from getagrip.geometry import camera, se3
from getagrip.timelines.hypotheses import Hypotheses

N_STATIC_FRAMES = 8
"""Number of frames of a static segment that are fitted: they show nearly the same."""
SUPPORT_WEIGHT = 0.01
"""Energy, in mean areas of the masks, of an object that floats at ``FLOATING_HEIGHT_M``."""
FLOATING_HEIGHT_M = 0.01
"""[m]."""
MAX_ENERGY_RATIO = 1.5
"""Solutions with more than this multiple of the least energy are dropped."""


def select_static_frames(segment: Segment, shown: Bool[ndarray, "T"]) -> Int[ndarray, "n"]:
    """Choose the frames of a static segment that determine its pose; none where fewer than two show the object."""
    seen = segment.rows[shown[segment.rows]]
    return seen[frame_indices(len(seen), N_STATIC_FRAMES)] if len(seen) > 1 else seen[:0]


def static_hypotheses(problem: Problem, frames: int, support: bool, start: Hypotheses | None = None) -> Hypotheses:
    """Search for one pose in the ``frames`` of a segment, by the problem at some of them.

    ``start`` are poses to begin with besides uniform rotations (their first frame's). ``support``: whether the plane
    counts. Raises ``GetagripError`` where nothing can be rendered.
    """
    assert problem.clip.world is not None
    T_cam_world = se3.inverse(problem.clip.world.T_world_cam)
    energy = (
        sum_energies(object_evidence_energy(problem), support_energy(problem))
        if support
        else object_evidence_energy(problem)
    )
    search = Search(T_cam_world, problem.surface, DEFAULT_SCHEDULE, lambda _: None)
    found = search.run(search.relax(static_initial_poses(problem, start), energy).core, energy)
    best = found.take(np.flatnonzero(found.energy <= MAX_ENERGY_RATIO * found.energy[0]))
    poses = replace(best.motion, frames=frames).poses()
    return Hypotheses(poses.R, poses.centre, poses.scale, best.energy)


def support_energy(problem: Problem) -> Energy:
    """Return the energy of an object above or below its support; zero where the plane is not known."""
    clip = problem.clip
    world = clip.world
    if world is None or world.up is None or world.support is None:
        return sum_energies()
    normal, height = plane_in_camera(world.T_world_cam, world.up, world.support)
    vertices = hull_vertices(clip.mesh.vertices - clip.mesh.centre)
    weight = SUPPORT_WEIGHT * float(problem.observation.area.mean()) / FLOATING_HEIGHT_M**2

    def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
        return [SupportTerm(vertices, normal[index], height[index], weight)]

    return terms


def static_initial_poses(problem: Problem, start: Hypotheses | None) -> Fixed:
    """Return the poses of ``start``, then uniform rotations on the ray through the first mask.

    These are as far away as the mask's size implies; with a free scale, as far as the hand is on average.
    """
    clip, inits = problem.clip, problem.options.inits
    assert clip.world is not None
    T_world_cam = clip.world.T_world_cam[0]
    R = se3.super_fibonacci(inits if start is None else inits - len(start.R))
    box = camera.bounding_boxes(problem.masks.object[:1])[0].astype(float)
    in_camera = (clip.mesh.vertices - clip.mesh.centre) @ np.swapaxes(T_world_cam[:3, :3].T @ R, -1, -2)
    extent = np.ptp(in_camera[..., :2], axis=1).max(axis=-1)
    seen = float(np.max(box[2:] - box[:2])) / clip.K[0, 0, 0]
    depth, log_scale = extent / seen, np.zeros(len(R))
    if clip.scale == "free":
        hand = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices).mean(axis=(0, 1))[2]
        depth, log_scale = np.full(len(R), hand), np.log(hand / depth)
    ray = camera.backproject(clip.K[:1], ((box[:2] + box[2:]) / 2.0)[None, None])[0, 0]
    centre = se3.transform(T_world_cam, depth[:, None] * ray)
    if start is not None:
        R, centre = np.concatenate([start.R[:, 0], R]), np.concatenate([start.centre[:, 0], centre])
        log_scale = np.concatenate([np.log(start.scale), log_scale])
    return Fixed(R, centre, log_scale, len(clip), clip.scale == "free")


@dataclass(frozen=True)
class SupportTerm:
    """``weight * h^2 / (1 + h^2 / far^2)`` in each frame, h the height of the lowest vertex over the plane.

    An object may lie on something else that lies on the plane: beyond ``far``, more height costs little more.
    """

    vertices: Float[ndarray, "V 3"]
    """Vertices of the object about its centre, unscaled [m]; those of the convex hull are enough."""
    normal: Float[ndarray, "N 3"]
    """Up, in the camera frame."""
    height: Float[ndarray, "N"]
    """Height of the plane along it, from the camera [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    far: float = 0.02
    """[m]."""
    name: str = "support"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        scale = poses.scale[:, None, None]
        up = np.broadcast_to(self.normal, poses.centre.shape)
        along = scale * (np.swapaxes(poses.R, -1, -2) @ up[..., None])[..., 0] @ self.vertices.T
        lowest = np.argmin(along, axis=-1)
        arm = scale * (poses.R @ self.vertices[lowest][..., None])[..., 0]
        h = np.sum((poses.centre + arm) * up, axis=-1) - self.height
        shape = 1.0 / (1.0 + (h / self.far) ** 2)
        J = np.concatenate([up, np.cross(arm, up), np.sum(arm * up, axis=-1, keepdims=True)], axis=-1)
        slope = 2.0 * self.weight * shape**2 * h
        H = 2.0 * self.weight * (shape**2)[..., None, None] * (J[..., :, None] * J[..., None, :])
        return Quadratic(self.weight * shape * h**2, slope[..., None] * J, H)


def hull_vertices(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "n 3"]:
    """Return the vertices that can be the lowest."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:  # a flat mesh
        return vertices


def plane_in_camera(
    T_world_cam: Float[ndarray, "N 4 4"], up: Float[ndarray, "3"], support: float
) -> tuple[Float[ndarray, "N 3"], Float[ndarray, "N"]]:
    """Return normal and height of the world's plane in the camera frame."""
    normal = (se3.inverse(T_world_cam)[:, :3, :3] @ up[:, None])[..., 0]
    return normal, support - T_world_cam[:, :3, 3] @ up
