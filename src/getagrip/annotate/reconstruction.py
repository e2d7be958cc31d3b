"""From the files of a labelled grasp to a result: the commands that a person would type, one after the other.

Each runs in a process of its own: the page stays quick meanwhile, and ending one ends all that it does.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path

from getagrip.annotate.background import BackgroundJob, CancelledError
from getagrip.annotate.versions import RefusedError
from getagrip.clip.depth import DEPTH_KEY, DepthSource
from getagrip.clip.depth_sources import DepthReader, add_depth, check_focal_length
from getagrip.clip.reading import read_header
from getagrip.errors import GetagripError, InputError
from getagrip.io import files, own_python
from getagrip.io.files import Json, shorten_value

CLIPS_FOLDER, RESULTS_FOLDER = "clips", "results"
"""Folders beside the marks."""
REPORT_FILES = ("report.html", "report.png")
MAX_MESH_PATH_LENGTH = 1000
"""Characters of a path."""
MAX_OBJECT_SIZE_MM = 10_000.0
SUCCESS_STATUSES = (0, 3)
"""Exit statuses of commands that have made what they were asked for, with something to be known about it or not."""
CANCEL_POLL_S = 0.3
"""How often it is asked whether the work is still wanted [s]."""


@dataclass(frozen=True)
class RequestedMesh:
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

    reader: DepthReader
    frames: Sequence[str]
    """Names of the reader's frames."""
    source: DepthSource
    said: str
    """Source of the images, for the clip's provenance."""

    def add_to(self, clip: Path) -> str:
        """Add those of its frames to a clip; returns what is wrong with them, or nothing. Raises ``InputError``."""
        header, places = read_header(clip), {self.frames[row]: row for row in self.reader.known}
        rows = {n: places[name] for n, name in enumerate(header.frames) if name in places}
        if not rows:
            return f"there is no depth image of any frame of {clip.name}"
        own = replace(self.reader, read=lambda n: self.reader.read(rows[n]), known=[*rows])
        add_depth(header, own, self.source, self.said)
        without = len(header.frames) - len(rows)
        missing = f"{without} of {len(header.frames)} frames have no depth image" if without else ""
        return "; ".join(
            filter(None, (missing, check_focal_length(self.reader, self.source, header.K, header.size[0])))
        )


def parse_requested_mesh(content: Json) -> RequestedMesh:
    """Parse a request's mesh. Raises ``RefusedError``."""
    mesh, size = content.get("mesh"), content.get("size_mm")
    if not isinstance(mesh, str) or not mesh.strip() or len(mesh) > MAX_MESH_PATH_LENGTH or not mesh.isprintable():
        raise RefusedError("missing mesh: a file, or a kind such as plate or mug")
    if mesh.strip().startswith("-"):
        raise RefusedError(f"mesh must be a file, or a kind such as plate or mug (got {shorten_value(mesh)})")
    if size is not None and (type(size) not in (int, float) or not 0 < size <= MAX_OBJECT_SIZE_MM):
        raise RefusedError(f"size must be millimetres above 0, or nothing (got {shorten_value(size)})")
    return RequestedMesh(mesh.strip(), None if size is None else float(size))


def report_files(result: Path) -> dict[str, bytes]:
    """Read the files of a result's report by their names; links are none."""
    return {
        path.name: path.read_bytes()
        for name in REPORT_FILES
        if (path := result / name).is_file() and not path.is_symlink()
    }


def draw_report(result: Path, job: BackgroundJob) -> str:
    """Write the report of a result. Raises ``GetagripError``, ``CancelledError``."""
    return run_command(["report", str(result)], job)


def result_folder(out: Path, name: str) -> Path:
    """Return the folder of a grasp's result."""
    return out / RESULTS_FOLDER / name


def reconstruct_grasp_files(
    new_clip: Sequence[str],
    shape: RequestedMesh,
    out: Path,
    name: str,
    job: BackgroundJob,
    depth: DepthFiles | None = None,
) -> str:
    """Make the clip with ``new_clip``, the words of ``clip new`` but for mesh and folder; reconstruct it, and report.

    Returns what was said of it, warnings about the clip first. Raises ``GetagripError`` with what a command said
    against it, ``CancelledError``.
    """
    clip, result = files.folder_inside(out, CLIPS_FOLDER) / name, files.folder_inside(out, RESULTS_FOLDER) / name
    make = [*new_clip, *shape.options, "--out", str(clip), "--overwrite", "--quiet"]
    solve = ["reconstruct", str(clip), "--out", str(result.parent), "--overwrite", "--threads", "2"]
    lost = f"depth images of the earlier {clip} are left out" if depth is None and (clip / DEPTH_KEY).exists() else ""
    steps: list[tuple[str, Callable[[], str]]] = [
        ("making the clip", lambda: run_command(make, job)),
        ("adding depth", lambda: lost if depth is None else depth.add_to(clip)),
        ("reconstructing", lambda: run_command(solve, job)),
        ("drawing the report", lambda: draw_report(result, job)),
    ]
    said = []
    for n, (what, work) in enumerate(steps):
        job.message = what
        job.report(n, len(steps))
        said.append(work())
    return "\n".join(filter(None, said[:-1]))


def iou_by_frame(result: Path) -> dict[str, float]:
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
    """Run a command; returns what it printed. Raises ``GetagripError`` where it made nothing.

    What lacks something is made, too: its exit status is ``SUCCESS_STATUSES``, and what it lacks is among what it printed.
    """
    process = subprocess.Popen(
        own_python.python_command("-m", "getagrip", *words),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
    )  # fmt: skip
    while True:
        try:
            out, err = process.communicate(timeout=CANCEL_POLL_S)
            break
        except subprocess.TimeoutExpired:
            try:
                job.report(job.done, job.total)
            except CancelledError:
                process.terminate()
                process.communicate()
                raise
    if process.returncode not in SUCCESS_STATUSES:
        said = (err.strip() or out.strip() or "it ended early").splitlines()
        raise GetagripError("; ".join(line.removeprefix("getagrip: ") for line in said))
    return "\n".join(filter(None, (out.strip(), err.strip())))
