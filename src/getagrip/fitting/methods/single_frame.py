"""Single Frame (paper, Sec. 5.1): every frame on its own, without any temporal knowledge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.errors import GetagripError
from getagrip.fitting.energy import Term
from getagrip.fitting.initial_poses import starting_poses
from getagrip.fitting.motion import Fixed, Motion
from getagrip.fitting.objective import energy_of
from getagrip.fitting.problem import Found, Problem
from getagrip.fitting.search import Schedule, Stage, TermsAt, search
from getagrip.fitting.solve import Solution, Status, minimise
from getagrip.geometry import se3

SCHEDULE = Schedule(
    static_iterations=8,
    loose_iterations=0,
    stages=(
        Stage("coarse", level=64, frames=1, iterations=6, keep=10, rounds=6),
        Stage("fine", level=128, frames=1, iterations=10, keep=4),
        Stage("finest", level=256, frames=1, iterations=16, keep=1),
    ),
)
"""The joint search's for one frame: no motion to find, so no loose fit."""
REFIT = Stage("refit", level=256, frames=1, iterations=15, keep=1)
"""At one scale, where it is free."""
WORST = (Status.LIMIT, Status.STUCK, Status.CONVERGED)
"""The status of the frames is the first of these that one of them has."""


def fit(problem: Problem, watch: Callable[[str], None]) -> Found:
    """The best pose of each frame. A free scale is each frame's own first; then all are fitted again at the median.

    ``watch`` is told the name of a stage when it ends. Raises ``GetagripError`` when nothing can be rendered in some
    frame.
    """
    clip, options = problem.clip, problem.options
    energy = energy_of(problem, options.push, options.pull)
    best = []
    for n in range(len(clip)):
        here = np.array([n])
        masks = Masks(problem.masks.object[here], problem.masks.ignore[here])
        found = search(
            starts=starting_poses(clip.take(here), masks, options.inits, options.seed, problem.poses),
            model=lambda loose: loose.core,
            terms_at=partial(_of_frame, energy, n),
            T_cam_hand=clip.hand.T_cam_hand[here],
            shape=problem.shape,
            schedule=SCHEDULE,
            watch=lambda _: None,
        )
        if not len(found.energy):
            raise GetagripError(f"frame {clip.frames[n]}: {Status.INVISIBLE}")
        best.append(found)
    watch("fine")
    if clip.scale == "free":
        best = _at_one_scale(problem, best, energy)
    held = [found.motion.poses() for found in best]
    R, centre = np.stack([h.R[0, 0] for h in held]), np.stack([h.centre[0, 0] for h in held])
    scale = held[0].scale[:1]
    status = [found.status[0] for found in best]
    watch("finest")
    return Found(
        T_hand_obj=se3.rigid(R, centre - scale * (R @ clip.mesh.centre))[None],
        scale=scale,
        energy=np.array([sum(found.energy[0] for found in best)]),
        terms={name: float(sum(found.terms[name][0] for found in best)) for name in best[0].terms},
        status=next(s for s in WORST if s in status).value,
    )


def _of_frame(energy: TermsAt, n: int, stage: Stage, _: Int[ndarray, "1"]) -> Sequence[Term]:
    """The energy of one frame, for a search that knows of no other."""
    return energy(stage, np.array([n]))


def _at_one_scale(problem: Problem, best: list[Solution[Motion]], energy: TermsAt) -> list[Solution[Motion]]:
    """The frames fitted again from where they look the same at the median of their scales."""
    held = [found.motion.poses() for found in best]
    scale = float(np.median([h.scale[0] for h in held]))
    again: list[Solution[Motion]] = []
    for n, (h, T) in enumerate(zip(held, problem.clip.hand.T_cam_hand, strict=True)):
        eye = se3.inverse(T)[:3, 3]
        centre = eye + scale / h.scale[0] * (h.centre[:1, 0] - eye)
        start: Motion = Fixed(h.R[:1, 0], centre, np.full(1, np.log(scale)), frames=1)
        again.append(minimise(start, energy(REFIT, np.array([n])), T[None], REFIT.iterations))
    return again
