"""From a clip and its masks to the object in the hand, in every frame (paper, Sec. 3.3), by whichever method."""

from __future__ import annotations

from collections.abc import Callable

from threadpoolctl import threadpool_limits

from getagrip.clip import Clip, Masks
from getagrip.fitting.methods import all_frames as joint
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Clock, Found, Problem, answer, prepare, read_sampled
from getagrip.result import Reconstruction


def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (Eq. 4).

    ``masks`` are those of the clip's frames; without them, those of the frames that are used are read from its folder.
    ``progress`` is called with the name of the stage that has ended and the fraction done. Raises ``InputError`` when
    the object is seen in fewer than two frames and ``GetagripError`` when nothing can be rendered.

    BLAS runs on one thread meanwhile, in the whole process: the matrices are small, and threads of it that wait for a
    core that somebody else has make a clip take ten times as long.
    """
    options = options or Options()
    if masks is None:
        clip, masks = read_sampled(clip, options.frames)
    with threadpool_limits(1, user_api="blas"):
        clock = Clock(progress)
        problem = prepare(clip, masks, options)
        clock("prepare")
        return answer(problem, _fit(problem, clock), clock)


def _fit(problem: Problem, watch: Callable[[str], None]) -> Found:
    """The solutions of the method that the options name."""
    match problem.options.method:
        case "single-frame":
            from getagrip.fitting.methods import single_frame

            return single_frame.fit(problem, watch)
        case "homan":
            from getagrip.fitting.methods import homan

            return homan.fit(problem, watch)
        case "contact-consistency":
            from getagrip.fitting.methods import contact_consistency

            return contact_consistency.fit(problem, watch)
        case _:
            return joint.fit(problem, watch)
