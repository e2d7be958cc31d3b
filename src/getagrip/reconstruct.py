"""From a clip and its masks to the object in the hand, in every frame (paper, Sec. 3.3), by whichever method."""

from __future__ import annotations

from collections.abc import Callable

from getagrip import joint
from getagrip.clip import Clip, Masks
from getagrip.options import Options
from getagrip.problem import Clock, answer, prepare
from getagrip.result import Reconstruction


def reconstruct(
    clip: Clip, masks: Masks, options: Options | None = None, progress: Callable[[str, float], None] | None = None
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (Eq. 4).

    ``progress`` is called with the name of the stage that has ended and the fraction done. Raises ``InputError`` when
    the object is seen in fewer than two frames and ``GetagripError`` when nothing can be rendered.
    """
    clock = Clock(progress)
    problem = prepare(clip, masks, options or Options())
    clock("prepare")
    return answer(problem, joint.fit(problem, clock), clock)
