"""The next step of labelling: the frame on which to draw, and advice on a result that looks wrong.

Suggested frames are first those where the object is lost, then the ends, then those where drawing helps most.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from getagrip.clip.match_frames import number_of
from getagrip.errors import InputError
from getagrip.io.terminal import format_ranges
from getagrip.result import Reconstruction, read_result
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.masks.box_prompt import Box
from getagrip.studio.masks.propagate_clip import keyframe_spans
from getagrip.studio.shown_result import largest_jump

MAX_SUGGESTED_FRAMES = 4
"""Maximum number of drawn frames up to which another one is suggested."""
MASK_CONFIDENCE_THRESHOLD = 0.95
"""Confidence of all masks from which on no frame is suggested."""
MIN_MASK_IOU = 1e-3
"""Lower limit of the IOU of a result with a mask."""
MIN_FRAMES_BEFORE_JUMP = 10
"""Minimum number of frames before a jump for which a draft of them is advised."""


def next_step(
    result: Path,
    video: Path,
    out: Path,
    shape: RequestedMesh,
    wanted: int | None,
    lost: Sequence[int],
    taken: tuple[int, int],
    box: Box | None = None,
) -> str:
    """Return advice on a result that looks wrong, as text; empty for a good one.

    Frames are the footage's own numbers: ``wanted`` is the suggested frame, ``lost`` are those in which the object is
    lost, ``taken`` are the first and last frame of the grasp; ``box`` is the object's in the first one [px]. ``out`` is
    the folder of the marks of the ``video``.
    """
    try:
        found = read_result(result)[0]
    except InputError:  # the result's report names the error
        return ""
    wrong = "wrong" in found.looks or any(finding.serious for finding in found.findings)
    said = []
    if lost:
        said.append(f"the object is lost in the frames {format_ranges(lost, 0)}")
    if wrong or lost:
        page = shlex.join(["getagrip", "annotate", str(video), "--out", str(out)])
        draw = f"draw the object on frame {wanted}" if wanted is not None else "correct the masks"
        steps = [f"{draw}, and reconstruct again, on the page: {page}"]
        if wrong:
            steps += _interval_advice(found, taken, box)
        if wrong and not Path(shape.mesh).is_file():
            steps.append(f"with --object FILE, the object's own mesh: the shape of {shape.mesh} is a guess")
        said.append(f"next: {'; or '.join(steps)}")
    return "\n".join(said)


def _interval_advice(found: Reconstruction, taken: tuple[int, int], box: Box | None) -> list[str]:
    """Return advice on the frames of the grasp: those before a jump in the hand, if any, unless they are few."""
    if len(found.frames) < 3:
        return []
    if not any(finding.check == "regrasp" for finding in found.findings):
        some = f"if the object is grasped only in some of the frames {taken[0]} to {taken[1]}"
        return [f"draft it anew with --interval FIRST LAST, {some}"]
    before, after = (_frame_number(found, n, taken[0]) for n in largest_jump(found))
    first, last, begins = taken[0], before, "" if box is None else ",".join(f"{x:.0f}" for x in box)
    if last - first < MIN_FRAMES_BEFORE_JUMP:
        first, last, begins = after, taken[1], "X,Y,W,H"
    words = f"--interval {first} {last}" + (f" --object-box {begins}" if begins else "")
    return [f"draft it anew with {words}: the object jumps in the hand between the frames {before} and {after}"]


def _frame_number(found: Reconstruction, index: int, first: int) -> int:
    """Return the number in the name of a result's frame; without one, its index plus the number of the first frame."""
    number = number_of(found.frames[index])
    return first + index if number is None else number


def discount_confidence(
    confidence: Mapping[int, float], iou: Mapping[int, float], drawn: Collection[int]
) -> Mapping[int, float]:
    """Return the confidence of masks, less where the ``iou`` of a result with them is lower than on ``drawn`` frames.

    Between drawn frames the expected IOU is interpolated.
    """
    known = sorted(n for n in drawn if n in iou)
    if not known:
        return confidence
    expected = np.maximum(np.interp([*confidence], known, [iou[n] for n in known]), MIN_MASK_IOU)
    return {
        n: min(sure, max(iou.get(n, at), MIN_MASK_IOU) / at)
        for (n, sure), at in zip(confidence.items(), expected.tolist(), strict=True)
    }


def lost_frames(confidence: Mapping[int, float]) -> list[int]:
    """Return the frames in which the object is lost (``propagate_clip``)."""
    return sorted(n for n, sure in confidence.items() if sure == 0.0)


def suggest_frame(confidence: Mapping[int, float], drawn: Collection[int], first: int, last: int) -> int | None:
    """Return the frame from ``first`` to ``last`` on which drawing helps most; None if no frame is needed.

    ``confidence`` is that of the frames' masks; frames without one are still being drafted. A drawn frame at a distance
    d is assumed to raise a frame's confidence by the fraction 1 - d / D of what it lacks, with D the frame's distance
    from the frames drawn before.
    """
    if not drawn:
        return first
    if lost := [n for n in lost_frames(confidence) if first <= n <= last]:
        return min(lost, key=lambda n: min(abs(n - key) for key in drawn))
    if len(drawn) == 1:
        (only,) = drawn
        return last if 2 * only < first + last else first
    unsure = np.array([1.0 - confidence.get(n, np.nan) for n in range(first, last + 1)])
    if len(drawn) >= MAX_SUGGESTED_FRAMES or np.isnan(unsure).any() or unsure.max() <= 1.0 - MASK_CONFIDENCE_THRESHOLD:
        return None
    best, most = None, 0.0
    for span in keyframe_spans(drawn, first, last):
        frames = np.arange(span.first, span.last + 1)
        for n in frames[~np.isin(frames, span.keys)]:
            sides = [np.abs(key - (n if len(span.keys) == 2 else frames)) for key in span.keys]
            beyond = sides[0] if len(sides) == 1 else np.where(frames < n, *sides)
            fraction = np.clip(1.0 - np.abs(frames - n) / np.maximum(beyond, 1), 0, 1)
            resolved = float((unsure[frames - first] * fraction).sum())
            if resolved > most:
                best, most = int(n), resolved
    return best
