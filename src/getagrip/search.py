"""Multi-start, coarse-to-fine search: many rotations at low resolution and few frames, fewer and fewer at higher.

Pruning waits until the wanted motion model has been fitted: on the energy of a static fit the right start is often
lost. The axis of a hinge comes from the data: after a static fit, a fit with a small free deviation per frame, whose
rotation vectors' principal direction is the axis. (Angle zero about any axis is a dead start: the energy does not see
the axis there.) The best coarse fits are tried again reversed in depth, which silhouettes can hardly tell apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip import se3
from getagrip.energy import Term
from getagrip.motion import Fixed, Free, Hinge, InHand, Motion, Soft
from getagrip.solve import Solution, minimise

M = TypeVar("M", bound=Motion)

RIDGE = (2e5 / 16, 1.2e3 / 16)
"""Stiffness of the deviations while the axis is looked for [px^2 per m^2, px^2 per rad^2]."""


MAX = 10**9
"""As many frames as there are."""


@dataclass(frozen=True)
class Stage:
    """One resolution: how many frames, which level, how long, and how many hypotheses go on to the next."""

    name: str
    level: int
    frames: int
    iterations: int
    keep: int


@dataclass(frozen=True)
class Schedule:
    """The whole search."""

    static_iterations: int = 4
    loose_iterations: int = 3
    reversed: int = 6
    """How many of the best coarse fits are also tried reversed in depth."""
    stages: tuple[Stage, ...] = (
        Stage("coarse", level=64, frames=8, iterations=5, keep=16),
        Stage("middle", level=64, frames=15, iterations=6, keep=6),
        Stage("fine", level=128, frames=MAX, iterations=8, keep=4),
        Stage("finest", level=256, frames=MAX, iterations=8, keep=4),
    )


TermsAt = Callable[[Stage, Int[ndarray, "n"]], Sequence[Term]]
"""The energy of a stage at some of the frames."""


def spread(frames: int, wanted: int) -> Int[ndarray, "n"]:
    """Indices of ``wanted`` frames, linearly spread, the ends included; all of them if there are fewer."""
    return np.unique(np.round(np.linspace(0, frames - 1, min(wanted, frames))).astype(int))


def hinge_from(loose: Soft[Fixed], free_location: bool, anchor: Float[ndarray, "3"]) -> Hinge:
    """The hinge nearest to a loose fit: principal direction of its rotation vectors, angles along it.

    With ``free_location`` the line passes where the deviations' translations ask for, held near the object's centre by
    a ridge; otherwise through ``anchor`` (hand frame, m).
    """
    base = loose.core
    v, w = loose.deviation[..., :3], loose.deviation[..., 3:]
    mean = w.mean(axis=1, keepdims=True)
    _, _, Vt = np.linalg.svd(w - mean)
    direction = Vt[:, 0]
    angle = np.sum((w - mean) * direction[:, None], axis=-1)
    offset = v - v.mean(axis=1, keepdims=True)
    centre = base.centre + v.mean(axis=1)
    if free_location:
        # v_n = angle_n d x (centre - point): least squares for the arm, against 5 degrees of noise per frame.
        arm = np.cross(np.sum(angle[..., None] * offset, axis=1), direction)
        arm /= np.sum(angle**2, axis=1)[:, None] + v.shape[1] * np.radians(5.0) ** 2
        reach = np.linalg.norm(arm, axis=1, keepdims=True)
        point = centre - arm * np.minimum(1.0, 0.1 / np.maximum(reach, 1e-9))
    else:
        point = np.broadcast_to(anchor, centre.shape).copy()
    R = se3.exp_so3(mean[:, 0]) @ base.R
    return Hinge(R, centre, base.log_scale, point, direction, angle, base.free_scale, free_location)


def resampled(motion: M, old: Int[ndarray, "m"], new: Int[ndarray, "n"]) -> M:
    """The motion at other frames: per-frame parameters interpolated linearly, rotations to the nearest frame's."""
    if isinstance(motion, Fixed):
        return replace(motion, frames=len(new))
    if isinstance(motion, Hinge):
        return replace(motion, angle=np.stack([np.interp(new, old, a) for a in motion.angle]))
    if isinstance(motion, Soft):
        between = [[np.interp(new, old, column) for column in d.T] for d in motion.deviation]
        return replace(motion, core=resampled(motion.core, old, new), deviation=np.swapaxes(between, 1, 2))
    if isinstance(motion, Free):
        nearest = np.abs(new[:, None] - old[None]).argmin(axis=1)
        return replace(motion, R=motion.R[:, nearest], centre=motion.centre[:, nearest])
    raise TypeError(type(motion))


def distinct(motion: Motion, energy: Float[ndarray, "B"], corners: Float[ndarray, "8 3"], keep: int) -> ndarray:
    """Indices of the ``keep`` lowest energies, near-copies of a better one left out.

    Two hypotheses are the same if the object's bounding box (``corners``, about its centre) moves, on average over
    corners and frames, by less than 3 % of its diagonal.
    """
    held = motion.poses()
    placed = corners * held.scale[:, None, None, None] @ np.swapaxes(held.R, -1, -2) + held.centre[:, :, None]
    apart = 0.03 * float(np.linalg.norm(corners[-1] - corners[0]))
    chosen: list[int] = []
    for b in np.argsort(energy, kind="stable"):
        if len(chosen) == keep or not np.isfinite(energy[b]):
            break
        if all(np.linalg.norm(placed[b] - placed[c], axis=-1).mean() > apart for c in chosen):
            chosen.append(int(b))
    return np.array(chosen, dtype=int)


@dataclass(frozen=True)
class Shape:
    """What the search knows of the object, about its centre."""

    corners: Float[ndarray, "8 3"]
    """Corners of the bounding box, the first and the last opposite [m]."""
    axes: Float[ndarray, "3 3"]
    """Rows: unit normals of the planes the object is nearest to being its own mirror image in."""


def reversed_in_depth(
    held: InHand, T_cam_hand: Float[ndarray, "4 4"], shape: Shape, frame: int
) -> tuple[Float[ndarray, "k 3 3"], Float[ndarray, "k 3"]]:
    """The poses that look the same from far away: mirrored along the line of sight and in a plane of the object.

    A silhouette does not tell front from back (Necker's reversal). For an object that is its own mirror image in the
    plane with normal m the reversal ``(I - 2 v v^T) R (I - 2 m m^T)`` is a rotation; v is the line of sight.
    """
    R_cam_hand = T_cam_hand[:3, :3]
    sight = held.centre[:, frame] @ R_cam_hand.T + T_cam_hand[:3, 3]
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True) @ R_cam_hand
    flip = np.eye(3) - 2.0 * sight[:, :, None] * sight[:, None, :]
    mirror = np.eye(3) - 2.0 * shape.axes[:, :, None] * shape.axes[:, None, :]
    R = flip[:, None] @ held.R[:, None, frame] @ mirror
    return R.reshape(-1, 3, 3), np.repeat(held.centre[:, frame], 3, axis=0)


def search(
    starts: Fixed,
    model: Callable[[Soft[Fixed]], M],
    terms_at: TermsAt,
    T_cam_hand: Float[ndarray, "N 4 4"],
    shape: Shape,
    schedule: Schedule,
    watch: Callable[[str], None],
) -> Solution[M]:
    """Run the stages from B starting poses; the distinct solutions of the last stage, best first.

    ``model`` turns a loose fit into the wanted motion, ``watch`` is told the name of each stage when it ends. The
    result is empty when every start is behind the camera.
    """
    N = len(T_cam_hand)
    first = schedule.stages[0]
    index = spread(N, first.frames)
    terms = terms_at(first, index)
    T = T_cam_hand[index]

    def settle(start: Fixed) -> Solution[M]:
        static = minimise(replace(start, frames=len(index)), terms, T, schedule.static_iterations).motion
        loose = Soft(static, np.zeros((len(start.R), len(index), 6)), RIDGE)
        motion = model(minimise(loose, terms, T, schedule.loose_iterations).motion)
        return minimise(motion, terms, T, first.iterations)

    solution = settle(starts)
    seeds = solution.take(distinct(solution.motion, solution.energy, shape.corners, schedule.reversed))
    if not len(seeds.energy):
        return seeds
    middle = len(index) // 2
    held = seeds.motion.poses()
    R, centre = reversed_in_depth(held, T[middle], shape, middle)
    turned = settle(Fixed(R, centre, np.repeat(np.log(held.scale), 3), len(index), starts.free_scale))
    energy = np.concatenate([solution.energy, turned.energy])
    motion = solution.motion.joined(turned.motion)
    motion = motion.take(distinct(motion, energy, shape.corners, first.keep))
    watch(first.name)
    for stage in schedule.stages[1:]:
        wanted = spread(N, stage.frames)
        motion, index = resampled(motion, index, wanted), wanted
        solution = minimise(motion, terms_at(stage, index), T_cam_hand[index], stage.iterations)
        solution = solution.take(distinct(solution.motion, solution.energy, shape.corners, stage.keep))
        motion = solution.motion
        watch(stage.name)
    return solution
