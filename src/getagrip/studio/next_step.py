"""The next step after a result that does not look right: which frame to draw, which frames to take, which mesh."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from getagrip.clip.match_frames import number_of
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io.terminal import format_ranges
from getagrip.result import Reconstruction, read_result
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.masks.box_prompt import Box

OBJECT_HALF_SIZE_M = 0.04
"""Half the size of an object whose motion in the hand is looked at [m]."""
MIN_FRAMES_BEFORE_JUMP = 10
"""Frames before a jump of which a grasp is drafted, at least."""


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
    """Say what to do about a result; empty where nothing speaks against it.

    Frames are numbers that the page shows: ``wanted``, on which it helps most to draw; ``lost``, in which nothing is
    known of the object; ``taken``, the first and the last one, in the first of which ``box`` is the object's. ``out``
    is the folder of the marks of the ``video``.
    """
    try:
        found = read_result(result)[0]
    except InputError:  # its report will say so
        return ""
    wrong = "wrong" in found.looks or any(finding.serious for finding in found.findings)
    said = []
    if lost:
        said.append(f"the object is lost in the frames {format_ranges(lost, 0)}: nothing is known of it there")
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
    """Say which frames to take: those before a jump in the hand, if there is one, unless they are few."""
    if len(found.frames) < 3:
        return []
    if not any(finding.check == "regrasp" for finding in found.findings):
        some = f"if it is held only in some of the frames {taken[0]} to {taken[1]}"
        return [f"draft it anew with --interval FIRST LAST, {some}"]
    sampled = found.frames_of("sampled")
    points = se3.transform(found.T_hand_obj[sampled], OBJECT_HALF_SIZE_M * np.concatenate([np.eye(3), -np.eye(3)]))
    n = int(np.square(points[1:] - points[:-1]).sum(axis=(1, 2)).argmax())
    before, after = (_frame_number(found, int(sampled[k]), taken[0]) for k in (n, n + 1))
    first, last, begins = taken[0], before, "" if box is None else ",".join(f"{x:.0f}" for x in box)
    if last - first < MIN_FRAMES_BEFORE_JUMP:
        first, last, begins = after, taken[1], "X,Y,W,H"
    words = f"--interval {first} {last}" + (f" --object-box {begins}" if begins else "")
    return [f"draft it anew with {words}: the object jumps in the hand between the frames {before} and {after}"]


def _frame_number(found: Reconstruction, index: int, first: int) -> int:
    """Return the number of a result's frame, in its name; else its place, from that of the first one."""
    number = number_of(found.frames[index])
    return first + index if number is None else number
