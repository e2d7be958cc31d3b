"""Find the loose ends of a clip: frames in which the hand does not hold the object yet, or no longer.

The interval of a draft is a guess: reach and release often remain at its ends. No pose of a stable grasp meets their
masks; they are outliers, or met much less than the others, and mislead the axis. Only clips whose hand was lifted from
2D are shortened: all others are stable grasps already.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import was_lifted
from getagrip.checks.results import UNEVEN_IOU_RATIO
from getagrip.fitting.methods import METHODS
from getagrip.fitting.pipeline import FrameSolutions, RepairedInput

N_FIRM_FRAMES = 3
"""Number of consecutive frames with masks that are met, at which the grasp begins, and ends."""
MIN_KEPT_FRACTION, MIN_KEPT_FRAMES = 0.5, 8
"""Minimum fraction and number of a clip's frames that remain; where less would, all are used."""
MAX_FIRM_LOSS = 0.005
"""Mean IOU over the firm frames that a fit to these alone may lose; of a rendered plate, turned over, it lost 0.014."""
LOOSE_ENDS_NOTE = (
    "used are the frames {} to {}: no stable grasp meets the masks of the {} others, at the clip's ends; "
    "--given-interval uses all"
)


def without_loose_ends(source: RepairedInput, answer: FrameSolutions) -> RepairedInput | None:
    """Return the input in the frames of a firm grasp, by the ``answer`` in all of them; None where it stays as it is.

    It stays where the interval is given, the hand was not lifted from 2D, or the method does not choose its frames.
    """
    clip, track, options = source.clip, answer.track, source.options
    chosen = options.interval == "firm" and METHODS[options.method].checks_masks
    if not chosen or clip.segments or not was_lifted(clip) or len(track.frames) < MIN_KEPT_FRAMES:
        return None
    kept = track.frames[firm_rows(track.iou)]
    first, last = clip.index_of((kept[0], kept[-1])).tolist()
    index = np.arange(first, last + 1)
    if len(index) == len(clip):
        return None
    note = LOOSE_ENDS_NOTE.format(kept[0], kept[-1], len(clip) - len(index))
    return replace(source, original=source.original.take(index), clip=clip.take(index), notes=(*source.notes, note))


def meets_firm_frames(firm: FrameSolutions, before: FrameSolutions) -> bool:
    """Return whether a fit to the firm frames alone meets their masks as well as the fit to all frames did.

    Of two poses that look alike, fewer frames may find the wrong one, which then meets them less.
    """
    place = {name: n for n, name in enumerate(before.track.frames)}
    rows = [place[name] for name in firm.track.frames if name in place]
    now, then = (np.nan_to_num(iou).mean() for iou in (firm.track.iou, before.track.iou[rows]))
    return bool(now >= then - MAX_FIRM_LOSS)


def firm_rows(iou: Float[ndarray, "T"]) -> slice:
    """Return the rows from the first to the last ``N_FIRM_FRAMES`` consecutive masks that are met; all where few are.

    ``iou`` is NaN for a mask that is an outlier, or unknown.
    """
    rows, known = len(iou), np.isfinite(iou)
    least = UNEVEN_IOU_RATIO * float(np.median(iou[known])) if known.any() else 0.0
    between = np.flatnonzero(~(np.nan_to_num(iou, nan=-1.0) >= least)).tolist()
    runs = [(a, b) for a, b in pairwise([-1, *between, rows]) if b - a > N_FIRM_FRAMES]
    first, end = (runs[0][0] + 1, runs[-1][1]) if runs else (0, 0)
    short = end - first < max(MIN_KEPT_FRAMES, MIN_KEPT_FRACTION * rows)
    return slice(0, rows) if short else slice(first, end)
