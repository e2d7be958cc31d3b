"""The next step after a result that does not look right: which frame to draw, which frames to take, which mesh."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from getagrip.annotate.reconstruction import Shape
from getagrip.errors import InputError
from getagrip.io.terminal import ranges
from getagrip.result import read_result


def next_step(
    result: Path, video: Path, out: Path, shape: Shape, wanted: int | None, lost: Sequence[int], taken: tuple[int, int]
) -> str:
    """Say what to do about a result; empty where nothing speaks against it.

    Frames are numbers that the page shows: ``wanted``, on which it helps most to draw; ``lost``, in which nothing is
    known of the object; ``taken``, the first and the last one. ``out`` is the folder of the marks of the ``video``.
    """
    try:
        found = read_result(result)[0]
    except InputError:  # its report will say so
        return ""
    wrong = "wrong" in found.looks or any(finding.serious for finding in found.findings)
    said = []
    if lost:
        said.append(f"the object is lost in the frames {ranges(lost, 0)}: nothing is known of it there")
    if wrong or lost:
        page = shlex.join(["getagrip", "annotate", str(video), "--out", str(out)])
        draw = f"draw the object on frame {wanted}" if wanted is not None else "correct the masks"
        steps = [f"{draw}, and reconstruct again, on the page: {page}"]
        if wrong:
            steps.append(
                f"draft it anew with --interval FIRST LAST if it is held only in some of {taken[0]} to {taken[1]}"
            )
        if wrong and not Path(shape.mesh).is_file():
            steps.append(f"with --object FILE, the object's own mesh: the shape of {shape.mesh} is a guess")
        said.append(f"next: {'; or '.join(steps)}")
    return "\n".join(said)
