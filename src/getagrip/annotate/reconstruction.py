"""From the files of a labelled grasp to a result: the commands that a person would type, one after the other.

Each runs in a process of its own: the page stays quick meanwhile, and ending one ends all that it does.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path

from getagrip.annotate.background import BackgroundJob, CancelledError
from getagrip.annotate.versions import RefusedError
from getagrip.errors import GetagripError, InputError
from getagrip.io import files
from getagrip.io.files import Json, shown

CLIPS, RESULTS = "clips", "results"
"""Folders beside the marks."""
LONGEST = 1000
"""Characters of a path."""
LARGEST_MM = 10_000.0
WARNED = 3
"""Exit status of a command that did its work, and warns of it."""
ASKED = 0.3
"""How often it is asked whether the work is still wanted [s]."""


@dataclass(frozen=True)
class Shape:
    """The object's mesh, as the page states it."""

    mesh: str
    """A file, or a kind of this package's own meshes."""
    size_mm: float | None
    """Largest side of its bounding box; None where it is to be found."""

    @property
    def options(self) -> list[str]:
        """Options of ``clip new``."""
        return ["--mesh", self.mesh, *([] if self.size_mm is None else ["--size-mm", f"{self.size_mm:g}"])]


@dataclass(frozen=True)
class DepthFiles:
    """Depth images of a video's frames."""

    path: Path
    form: str
    """Name in ``clip.depth_sources.SOURCES``."""
    zero: int | None
    """Number that the files give to the video's first frame, below 0 too; None: they are numbered as its frames."""

    def words(self, first: int) -> list[str]:
        """Return the words of ``import depth`` but for the clip, whose first frame is the video's ``first``, from 0."""
        number = [] if self.zero is None else ["--first", str(self.zero + first)]
        return ["import", "depth", str(self.path.absolute()), "--from", self.form, *number, "--overwrite"]


def shape_of(content: Json) -> Shape:
    """Parse a request's mesh. Raises ``RefusedError``."""
    mesh, size = content.get("mesh"), content.get("size_mm")
    if not isinstance(mesh, str) or not mesh.strip() or len(mesh) > LONGEST or not mesh.isprintable():
        raise RefusedError("missing mesh: a file, or a kind such as plate or mug")
    if mesh.strip().startswith("-"):
        raise RefusedError(f"mesh must be a file, or a kind such as plate or mug (got {shown(mesh)})")
    if size is not None and (type(size) not in (int, float) or not 0 < size <= LARGEST_MM):
        raise RefusedError(f"size must be millimetres above 0, or nothing (got {shown(size)})")
    return Shape(mesh.strip(), None if size is None else float(size))


def result_folder(out: Path, name: str) -> Path:
    """Return the folder of a grasp's result."""
    return out / RESULTS / name


def reconstruct(
    new_clip: Sequence[str], shape: Shape, out: Path, name: str, job: BackgroundJob, depth: Sequence[str] = ()
) -> str:
    """Make the clip with ``new_clip``, the words of ``clip new`` but for mesh and folder; reconstruct it, and report.

    ``depth``: the words of ``import depth`` but for the clip, if there is any. Returns what was said of it, warnings
    about the clip first. Raises ``GetagripError`` with what a command said against it, ``CancelledError``.
    """
    clip, result = files.folder_inside(out, CLIPS) / name, files.folder_inside(out, RESULTS) / name
    steps = (
        ("making the clip", [*new_clip, *shape.options, "--out", str(clip), "--overwrite", "--quiet"]),
        *([("adding depth", [*depth, "--clip", str(clip), "--quiet"])] if depth else []),
        ("reconstructing", ["reconstruct", str(clip), "--out", str(result.parent), "--overwrite", "--threads", "2"]),
        ("drawing the report", ["report", str(result)]),
    )
    said = []
    for n, (what, words) in enumerate(steps):
        job.message = what
        job.report(n, len(steps))
        said.append(run_command(words, job))
    return "\n".join(filter(None, said[:-1]))


def iou_of(result: Path) -> dict[str, float]:
    """Return a result's IOU with the masks, by frame.

    Frames without a mask, and with an outlier mask, are left out; all are where the result does not read, which its
    report will say.
    """
    from getagrip.result import read_result

    try:
        found = read_result(result)[0]
    except InputError:
        return {}
    return {name: x for name, x in zip(found.frames, found.iou.tolist(), strict=True) if not isnan(x)}


def run_command(words: Sequence[str], job: BackgroundJob) -> str:
    """Run a command; returns what it printed. Raises ``GetagripError`` where it failed, not where it warned."""
    process = subprocess.Popen(
        [sys.executable, "-m", "getagrip", *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
    )  # fmt: skip
    while True:
        try:
            out, err = process.communicate(timeout=ASKED)
            break
        except subprocess.TimeoutExpired:
            try:
                job.report(job.done, job.total)
            except CancelledError:
                process.terminate()
                process.communicate()
                raise
    if process.returncode not in (0, WARNED):
        raise GetagripError((err.strip() or out.strip() or "it ended early").removeprefix("getagrip: "))
    return "\n".join(filter(None, (out.strip(), err.strip())))
