"""Multi-start, coarse-to-fine search: many rotations at low resolution and few frames, fewer and fewer at higher.

Pruning waits until the motion model has been fitted: on the energy of a static fit the right start is often lost. Then
the best are turned and fitted again, a few rounds of it: local minima lie side by side, and in pairs; once more by less
in the middle, for a mug whose handle is in the hand has minima all around it. The axis of a
hinge comes from the data: after a static fit, a fit with a small free deviation per frame, whose rotation vectors'
principal direction is the axis. (Angle zero about any axis is a dead start: the energy does not see the axis there.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy import Term
from getagrip.fitting.motion import Fixed, Free, Hinge, InHand, Motion, Soft
from getagrip.fitting.solve import Solution, minimise
from getagrip.fitting.surface import Shape
from getagrip.geometry import se3

M = TypeVar("M", bound=Motion)

RIDGE = (2e5 / 16, 1.2e3 / 16)
"""Stiffness of the deviations while the axis is looked for [px^2 per m^2, px^2 per rad^2]."""
COARSE_RIDGE = (2e5 / 4, 1.2e3 / 4)
"""Stiffness of the deviations of a soft hinge in the coarse stages, where it has no axis yet, likewise."""
SOFT_RIDGE = (1.5e6, 1e4)
"""Stiffness of the deviations of a soft hinge, likewise."""
ANGLE_RIDGE = 400.0
"""Stiffness of a hinge's angles [px^2 per rad^2]: too weak to matter where an outline shows the angle, enough to keep a
bottle from spinning about its own axis, which no outline shows.
"""

SAME = 0.03
"""Hypotheses whose surfaces are nearer than this, in diameters, are one."""
MAX = 10**9
"""As many frames as there are."""


@dataclass(frozen=True)
class Turns:
    """Turns of the object that lead from one local minimum to another, from and to how many degrees."""

    random: tuple[float, float]
    """About any axis."""
    principal: tuple[float, float]
    """About one of the three principal axes, either way."""


FAR = Turns(random=(10.0, 40.0), principal=(180.0, 180.0))
"""To other poses; half a turn about a principal axis shows nearly the same outline."""
NEAR = Turns(random=(5.0, 20.0), principal=(8.0, 25.0))
"""Out of a minimum beside the best."""


@dataclass(frozen=True)
class Stage:
    """One resolution: how many frames, which level, how long, and how many hypotheses go on to the next."""

    name: str
    level: int
    frames: int
    iterations: int
    keep: int
    rounds: int = 0
    """How often the best of the stage are turned and fitted again."""
    parents: int = 8
    """How many of them."""
    turns: Turns = FAR
    """And by how much."""


@dataclass(frozen=True)
class Schedule:
    """The whole search."""

    static_iterations: int = 6
    loose_iterations: int = 3
    stages: tuple[Stage, ...] = (
        Stage("coarse", level=64, frames=8, iterations=5, keep=16, rounds=3),
        Stage("middle", level=64, frames=15, iterations=6, keep=6, rounds=1, parents=6, turns=NEAR),
        Stage("fine", level=128, frames=MAX, iterations=8, keep=4),
        Stage("finest", level=256, frames=MAX, iterations=8, keep=4),
    )


THOROUGH = Schedule(
    stages=(
        Stage("coarse", level=64, frames=8, iterations=5, keep=32, rounds=8, parents=12),
        Stage("middle", level=64, frames=15, iterations=8, keep=12, rounds=2, parents=8, turns=NEAR),
        Stage("fine", level=128, frames=MAX, iterations=12, keep=6, rounds=2, parents=3),
        Stage("finest", level=256, frames=MAX, iterations=16, keep=4),
    ),
)
"""A longer search: more hypotheses go on, and further, and are turned once more with all frames in view."""

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
    return Hinge(R, centre, base.log_scale, point, direction, angle, base.free_scale, free_location, ANGLE_RIDGE)


def stiffened(loose: Soft[Fixed]) -> Soft[Fixed]:
    """The motion of a soft hinge's coarse stages: a fit as loose, but held a little more."""
    return replace(loose, ridge=COARSE_RIDGE)


def soft_hinge(motion: Motion, free_location: bool, anchor: Float[ndarray, "3"]) -> Soft[Hinge]:
    """The same poses as those of the hinge nearest to them (``hinge_from``), and the deviations from it.

    Raises ``TypeError`` for a motion that is no loose fit.
    """
    if not (isinstance(motion, Soft) and isinstance(motion.core, Fixed)):
        raise TypeError(type(motion))
    hinge, held = hinge_from(motion, free_location, anchor), motion.poses()
    core = hinge.poses()
    w = se3.log_so3(held.R @ np.swapaxes(core.R, -1, -2))
    return Soft(hinge, np.concatenate([held.centre - core.centre, w], axis=-1), SOFT_RIDGE)


def resampled(motion: M, old: Int[ndarray, "m"], new: Int[ndarray, "n"]) -> M:
    """The motion at other frames: per-frame parameters interpolated linearly, rotations along the shortest turn."""
    if isinstance(motion, Fixed):
        return replace(motion, frames=len(new))
    if isinstance(motion, Hinge):
        return replace(motion, angle=np.stack([np.interp(new, old, a) for a in motion.angle]))
    if isinstance(motion, Soft):
        between = [[np.interp(new, old, column) for column in d.T] for d in motion.deviation]
        return replace(motion, core=resampled(motion.core, old, new), deviation=np.swapaxes(between, 1, 2))
    if isinstance(motion, Free):
        before = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 2)
        share = ((new - old[before]) / (old[before + 1] - old[before]))[:, None]
        R, centre = motion.R[:, before], motion.centre[:, before]
        turn = se3.log_so3(motion.R[:, before + 1] @ np.swapaxes(R, -1, -2))
        centre = centre + share * (motion.centre[:, before + 1] - centre)
        return replace(motion, R=se3.exp_so3(share * turn) @ R, centre=centre)
    raise TypeError(type(motion))


def distinct(held: InHand, energy: Float[ndarray, "B"], shape: Shape, keep: int) -> Int[ndarray, "n"]:
    """Indices of the ``keep`` lowest finite energies, near-copies of a better one left out.

    Two hypotheses are the same if the object's surface moves by less than ``SAME`` of its diameter.
    """
    few = spread(held.R.shape[1], 3)
    R, centre, scale = held.R[:, few], held.centre[:, few], held.scale
    chosen: list[int] = []
    for b in np.argsort(energy, kind="stable"):
        if len(chosen) == keep or not np.isfinite(energy[b]):
            break
        gaps = (
            shape.apart(R[b], centre[b], float(scale[b]), R[chosen], centre[chosen], scale[chosen]) if chosen else 1.0
        )
        if np.all(gaps > SAME):
            chosen.append(int(b))
    return np.array(chosen, dtype=int)


def turned(axes: Float[ndarray, "3 3"], by: Turns, count: int, rng: np.random.Generator) -> Float[ndarray, "n 3 3"]:
    """``count`` rotations about random axes, then ``count`` about the principal ones, the rows of ``axes``."""
    random = rng.normal(size=(count, 3))
    random *= np.radians(rng.uniform(*by.random, (count, 1))) / np.linalg.norm(random, axis=1, keepdims=True)
    angle = np.radians(rng.uniform(*by.principal, (count, 1))) * rng.choice([-1.0, 1.0], (count, 1))
    return se3.exp_so3(np.concatenate([random, angle * axes[rng.integers(3, size=count)]]))


def explored(
    solution: Solution[M],
    terms: Sequence[Term],
    T_cam_hand: Float[ndarray, "N 4 4"],
    shape: Shape,
    stage: Stage,
) -> Solution[M]:
    """The solutions of a stage, and those found from the best of them turned, in several rounds."""
    rng = np.random.default_rng(0)
    for _ in range(stage.rounds):
        parents = distinct(solution.motion.poses(), solution.energy, shape, stage.parents)
        if not len(parents):
            break
        children = solution.motion.take(np.tile(parents, 2))
        children = children.turned(turned(shape.axes, stage.turns, len(parents), rng))
        solution = solution.joined(minimise(children, terms, T_cam_hand, stage.iterations))
    return solution


def search(
    starts: Fixed,
    model: Callable[[Soft[Fixed]], Motion],
    terms_at: TermsAt,
    T_cam_hand: Float[ndarray, "N 4 4"],
    shape: Shape,
    schedule: Schedule,
    watch: Callable[[str], None],
    finer: Callable[[Motion], Motion] | None = None,
) -> Solution[Motion]:
    """Run the stages from B starting poses; the distinct solutions of the last stage, best first.

    ``model`` turns a loose fit into the motion of the coarse stages, ``finer`` that into another before the first stage
    that sees all frames. ``watch`` is told the name of each stage when it ends. The result is empty when every start is
    behind the camera.
    """
    N = len(T_cam_hand)
    first = schedule.stages[0]
    index = spread(N, first.frames)
    terms = terms_at(first, index)
    T = T_cam_hand[index]

    static = minimise(replace(starts, frames=len(index)), terms, T, schedule.static_iterations).motion
    loose = Soft(static, np.zeros((len(starts.R), len(index), 6)), RIDGE)
    motion: Motion = model(minimise(loose, terms, T, schedule.loose_iterations).motion)
    for k, stage in enumerate(schedule.stages):
        if k:
            wanted = spread(N, stage.frames)
            motion, index = resampled(motion, index, wanted), wanted
            terms = terms_at(stage, index)
        if finer and stage.frames == MAX:
            motion, finer = finer(motion), None
        T = T_cam_hand[index]
        solution = explored(minimise(motion, terms, T, stage.iterations), terms, T, shape, stage)
        solution = solution.take(distinct(solution.motion.poses(), solution.energy, shape, stage.keep))
        motion = solution.motion
        watch(stage.name)
        if not len(solution.energy):
            break
    return solution
