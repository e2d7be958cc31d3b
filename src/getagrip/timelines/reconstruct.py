"""From a clip to the object in every frame: timelines by all of their segments, other clips as one stable grasp."""

from __future__ import annotations

from collections.abc import Callable

from getagrip.clip import Clip, Masks
from getagrip.fitting.grasp import GRASP
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import run
from getagrip.result import Reconstruction
from getagrip.timelines.steps import TIMELINE


def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Callable[[str, float], None] | None = None,
    threads: int = 1,
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (paper, Eq. 5).

    A clip without segments is one stable grasp. Of a timeline all segments are solved together, by one scale, and every
    frame has an answer.

    Args:
        clip: hands, mesh and camera (``read_clip``, ``Clip``); a free scale is found, too.
        masks: masks of all of the clip's frames. Without them, those of the frames that are used are read from the
            clip's folder.
        options: method, number of initial poses, weights and what of the inputs is believed; None for the usual ones.
            ``options.frames`` frames, sampled evenly, are fitted together, and the others follow from them.
        progress: called with the name of the stage that has ended and the fraction done, 0 to 1.
        threads: number of threads that share the hypotheses of a search. The result is the same to the last bit
            whatever their number. Two are worth it where one clip is waited for; many clips are done sooner by as many
            processes. A timeline is solved on one.

    Returns:
        The object's poses in the hand, what was believed, and how probable it is that they are right.

    Raises:
        UsageError: masks of another clip, or a timeline and another method than the soft hinge.
        InputError: what no clip can be (as of ``read_clip``), an object that is visible in fewer than two frames, or a
            timeline of which no segment can be solved.
        GetagripError: nothing can be rendered.
    """
    options = options or Options()
    if clip.segments:
        return run(TIMELINE, clip, masks, options, progress, threads)
    return run(GRASP, clip, masks, options, progress, threads)
