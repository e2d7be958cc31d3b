"""Single Frame (paper, Sec. 5.2): every frame is fitted independently."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.errors import GetagripError
from getagrip.fitting.energy import Energy, Term
from getagrip.fitting.methods import OnStage
from getagrip.fitting.motion import Fixed, PosesInHand
from getagrip.fitting.objective import energy_of
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.fitting.solver.search import ALL_FRAMES, Schedule, Search, Stage
from getagrip.fitting.solver.solve import Solution, minimise
from getagrip.geometry import se3
from getagrip.result import Status

SINGLE_FRAME_SCHEDULE = Schedule(
    static_iterations=8,
    relaxed_iterations=0,
    relaxed=ALL_FRAMES,
    coarse=(Stage("coarse", level=64, frames=1, iterations=6, keep=10, rounds=6),),
    fine=(
        Stage("fine", level=128, frames=1, iterations=10, keep=4),
        Stage("finest", level=256, frames=1, iterations=16, keep=1),
    ),
)
"""Search in one frame, which has no motion, and so no relaxed fit."""
REFIT_LEVEL, REFIT_ITERATIONS = 256, 15
"""Resolution [px] and iterations of the second fit where the scale is free."""
STATUS_PRECEDENCE = (Status.LIMIT, Status.STUCK, Status.CONVERGED, Status.FINISHED)
"""Order of statuses; a result has the first status that one of its frames has."""

OfFrame = Callable[[Problem, int, Energy], Solution[Fixed]]
"""From a problem, a frame and an energy to the solutions of that frame, best first."""
Again = Callable[[Problem, int, Energy, Fixed], Solution[Fixed]]
"""From a problem, a frame, an energy and one start to the solution of that frame."""


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """Fit the best pose of each frame by our energy and search.

    Raises ``GetagripError`` when no pose can be rendered in some frame.
    """
    energy = energy_of(problem, problem.options.push, problem.options.pull)
    return fit_each_frame(problem, on_stage, energy, _best_of_frame, _refit_frame)


def fit_each_frame(
    problem: Problem, on_stage: OnStage, energy: Energy, best_of_frame: OfFrame, again: Again
) -> MethodResult:
    """Fit the best pose of each frame; a free scale per frame first, then at the median of all frames' scales.

    Raises ``GetagripError`` when no pose can be rendered in some frame.
    """
    best = []
    for n, frame in enumerate(problem.clip.frames):
        try:
            best.append(best_of_frame(problem, n, energy))
        except GetagripError as error:
            raise GetagripError(f"frame {frame}: {error}") from error
    on_stage("fine")
    if problem.clip.scale == "free":
        best = _refit_at_median_scale(problem, best, energy, again)
    poses_by_frame = [found.motion.poses() for found in best]
    R, centre = np.stack([h.R[0, 0] for h in poses_by_frame]), np.stack([h.centre[0, 0] for h in poses_by_frame])
    status = [found.status[0] for found in best]
    on_stage("finest")
    return MethodResult(
        poses=PosesInHand(R[None], centre[None], poses_by_frame[0].scale[:1]),
        energy=np.array([sum(found.energy[0] for found in best)]),
        terms={name: float(sum(found.terms[name][0] for found in best)) for name in best[0].terms},
        status=next(s for s in STATUS_PRECEDENCE if s in status),
    )


def initial_of_frame(problem: Problem, n: int) -> Fixed:
    """Return the initial poses of one frame."""
    here = np.array([n])
    masks = Masks(problem.masks.object[here], problem.masks.ignore[here])
    return initial_poses(problem.clip.take(here), masks, problem.inits, problem.options.seed, problem.prior_poses)


def _best_of_frame(problem: Problem, n: int, energy: Energy) -> Solution[Fixed]:
    def of_frame(level: int, _: Int[ndarray, "1"]) -> Sequence[Term]:
        return energy(level, np.array([n]))

    T = problem.clip.hand.T_cam_hand[n : n + 1]
    search = Search(T, problem.surface, SINGLE_FRAME_SCHEDULE, lambda _: None, problem.threads)
    motion = search.relax(initial_of_frame(problem, n), of_frame).core
    return search.run(motion, of_frame)


def _refit_frame(problem: Problem, n: int, energy: Energy, start: Fixed) -> Solution[Fixed]:
    T = problem.clip.hand.T_cam_hand[n : n + 1]
    return minimise(start, energy(REFIT_LEVEL, np.array([n])), T, REFIT_ITERATIONS)


def _refit_at_median_scale(
    problem: Problem, best: list[Solution[Fixed]], energy: Energy, again: Again
) -> list[Solution[Fixed]]:
    """Fit the frames again at the median of their scales, from poses of the same size in the image.

    Raises ``GetagripError`` where a frame cannot be rendered at this scale.
    """
    poses_by_frame = [found.motion.poses() for found in best]
    scale = float(np.median([h.scale[0] for h in poses_by_frame]))
    fitted = []
    for n, (h, T) in enumerate(zip(poses_by_frame, problem.clip.hand.T_cam_hand, strict=True)):
        eye = se3.inverse(T)[:3, 3]
        centre = eye + scale / h.scale[0] * (h.centre[:1, 0] - eye)
        start = Fixed(h.R[:1, 0], centre, np.full(1, np.log(scale)), frames=1)
        fitted.append(again(problem, n, energy, start))
        if fitted[-1].status[0] == Status.INVISIBLE:
            raise GetagripError(
                f"frame {problem.clip.frames[n]}, at the median of all frames' scales: {Status.INVISIBLE.sentence}"
            )
    return fitted
