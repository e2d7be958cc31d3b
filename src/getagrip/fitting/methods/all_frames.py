"""All frames fitted at once, the object moving in the hand as a motion model allows: 1-DoF, Static and Dynamic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from getagrip.errors import GetagripError
from getagrip.fitting.initial_poses import starting_poses
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion, Soft
from getagrip.fitting.objective import consistency_of, energy_of
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Found, Problem
from getagrip.fitting.search import MAX, THOROUGH, Schedule, TermsAt, hinge_from, search, soft_hinge, stiffened
from getagrip.fitting.solve import Status
from getagrip.geometry import se3
from getagrip.result import Axis

STEADY = 0.5
"""Weight of the soft hinge's own term (``objective.consistency_of``), in lambda_3."""
ALONE = 4.0
"""Push and pull count so much more where no other term ties the object to the hand."""


def fit(problem: Problem, watch: Callable[[str], None], more: TermsAt | None = None) -> Found:
    """Take the motion model of the problem's method through all stages of the search, with ``more`` terms if given.

    ``watch`` is told the name of each stage when it ends. Raises ``GetagripError`` when nothing can be rendered.
    """
    clip, options, centre = problem.clip, problem.options, problem.clip.mesh.centre
    model, finer = _models(options)
    solution = search(
        starts=starting_poses(clip, problem.masks, options.inits, options.seed, problem.poses),
        model=model,
        terms_at=terms_of(problem, more),
        T_cam_hand=clip.hand.T_cam_hand,
        shape=problem.shape,
        schedule=THOROUGH if options.thorough else Schedule(),
        watch=watch,
        finer=finer,
    )
    if not len(solution.energy):
        raise GetagripError(str(Status.INVISIBLE))
    held = solution.motion.poses()
    offset = held.scale[:, None, None] * (held.R @ centre)
    motion = solution.motion
    return Found(
        T_hand_obj=se3.rigid(held.R, held.centre - offset),
        scale=held.scale,
        energy=solution.energy,
        terms={name: float(value[0]) for name, value in solution.terms.items()},
        status=solution.status[0].value,
        axis=_axis(motion.core if isinstance(motion, Soft) else motion),
    )


def terms_of(problem: Problem, more: TermsAt | None = None) -> TermsAt:
    """The energy of the problem's method: Eq. 4, and ``more``; for the soft hinge a term where all frames are seen.

    Contact that stays is what makes a grasp stable (Eq. 2). A hinge keeps it by itself; where frames may deviate from
    the hinge, in depth above all, which outlines hardly show, the term says that it is kept.
    """
    options = problem.options
    if options.method == "soft-hinge" and options.pull:
        more = _late(consistency_of(problem, STEADY * options.pull))
    heavy = 1.0 if more else ALONE
    energy = energy_of(problem, heavy * options.push, heavy * options.pull)
    return (lambda stage, index: [*energy(stage, index), *more(stage, index)]) if more else energy


def _late(terms: TermsAt) -> TermsAt:
    """Terms for the stages that see all frames."""
    return lambda stage, index: terms(stage, index) if stage.frames == MAX else []


def _models(options: Options) -> tuple[Callable[[Soft[Fixed]], Motion], Callable[[Motion], Motion] | None]:
    """From the search's loose fit to the motion of the method, and from that to that of the finer stages, if another.

    The soft hinge has no axis at first: held to one too early, right poses lose whose motion is not quite a hinge.
    """
    anywhere, origin = options.axis == "free", np.zeros(3)
    if options.method == "static":
        return lambda loose: loose.core, None
    if options.method == "dynamic":

        def free(loose: Soft[Fixed]) -> Free:
            held = loose.poses()
            return Free(held.R, held.centre, loose.core.log_scale, loose.core.free_scale)

        return free, None
    if options.method == "soft-hinge":
        return stiffened, lambda motion: soft_hinge(motion, anywhere, origin)
    return lambda loose: hinge_from(loose, anywhere, origin), None


def _axis(motion: Motion) -> Axis | None:
    """The axis of the best candidate, where there is one."""
    if not isinstance(motion, Hinge):
        return None
    hinge = motion.zero_mean()
    return Axis(hinge.point[0], hinge.direction[0], hinge.angle[0])
