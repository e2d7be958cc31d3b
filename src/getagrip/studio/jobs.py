"""Jobs that take longer than a request of the page: drafts, clips, reconstructions, reports, estimators.

``BackgroundQueue`` runs the page's jobs in one thread, one after the other. A reconstruction is three ``CommandCall``:
the job decides where they run (``BackgroundJob.run``). The calls of the page's jobs run in processes, which cancelling
ends and whose load the page does not feel; those of a command, such as ``draft``, run in that command's process.

An estimator is a user's script that runs in an environment of its own, on a folder of images, and a line of
``ESTIMATORS``. The environment variable ``GETAGRIP_SAM2`` holds the command that starts the script of ``sam2``
(``scripts/estimators``); the words of the line are appended to it.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isnan
from pathlib import Path
from threading import Event, Lock
from typing import Literal, TypeAlias

from getagrip.clip.depth import DEPTH_KEY, DepthSource
from getagrip.clip.read import read_header
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.hands.model import Side
from getagrip.io import files, processes
from getagrip.io.files import Json, shorten_value
from getagrip.io.terminal import print_note
from getagrip.readers.depth_files import DepthReader, add_depth, check_focal_length
from getagrip.studio.store.grasp_settings import MAX_MESH_PATH_LENGTH, MAX_OBJECT_SIZE_MM
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL

THREADS_PER_CLIP = 2
"""Threads of a reconstruction."""


@dataclass(frozen=True, kw_only=True)
class NewClipCall:
    """Options of ``clip new`` for the files of a labelled grasp; ``MESH`` and ``CLIP`` are placeholders."""

    video: str
    interval: tuple[int, int]
    """First and last frame, counted from 1."""
    side: Side
    hands: Path
    masks: Path
    """Folder of masks, with the labels ``object``, ``ignore`` and ``hand``."""
    segments: Path | None = None
    mesh: str = "MESH"
    size_mm: float | None = None
    out: Path = Path("CLIP")
    overwrite: bool = False
    quiet: bool = False
    object: str = str(OBJECT_LABEL)
    ignore: str = str(OCCLUDER_LABEL)
    hand: str = str(HAND_LABEL)

    @property
    def words(self) -> list[str]:
        """Words after the program's name."""
        size = [] if self.size_mm is None else ["--size-mm", _shortest_number(self.size_mm)]
        return [
            *("clip", "new", self.video, "--interval", *map(str, self.interval), "--side", self.side),
            *("--hands", str(self.hands), "--masks", str(self.masks)),
            *("--object", self.object, "--ignore", self.ignore, "--hand", self.hand),
            *([] if self.segments is None else ["--segments", str(self.segments)]),
            *("--mesh", self.mesh, *size, "--out", str(self.out)),
            *["--overwrite"] * self.overwrite,
            *["--quiet"] * self.quiet,
        ]


@dataclass(frozen=True)
class ReconstructCall:
    """Options of ``reconstruct`` for one clip; the result ``out/<clip's name>`` is overwritten."""

    clip: Path
    out: Path

    @property
    def words(self) -> list[str]:
        """Words after the program's name."""
        return [
            *("reconstruct", str(self.clip), "--out", str(self.out), "--overwrite"),
            *("--threads", str(THREADS_PER_CLIP)),
        ]


@dataclass(frozen=True)
class ReportCall:
    """Options of ``report`` for one result."""

    result: Path

    @property
    def words(self) -> list[str]:
        """Words after the program's name."""
        return ["report", str(self.result)]


CommandCall: TypeAlias = NewClipCall | ReconstructCall | ReportCall
RunCall: TypeAlias = Callable[[CommandCall], str]
"""Runs a command and returns its output. Raises ``GetagripError`` with the output of a command that failed."""


def _shortest_number(number: float) -> str:
    """Format a number such that it is read back exactly."""
    return short if float(short := f"{number:g}") == number else repr(number)


class CancelledError(Exception):
    """Raised within work that was cancelled."""


@dataclass
class BackgroundJob:
    """A piece of work and its progress."""

    what: str
    """In a word: "propagate", "files"."""
    state: str = "waiting"
    """Then "running", and at last "done", "failed" or "cancelled"."""
    done: int = 0
    total: int = 0
    message: str = ""
    """Error, or a description of the output."""
    stop: Event = field(default_factory=Event)

    def report(self, done: int, total: int) -> None:
        """Note the progress. Raises ``CancelledError`` once the work was cancelled."""
        self.done, self.total = done, total
        if self.stop.is_set():
            raise CancelledError

    def run(self, call: CommandCall) -> str:
        """Run a command as ``RunCall``: here in a process of its own, which cancelling the job ends."""
        return run_command(call.words, self)

    def status(self) -> dict[str, object]:
        """Return the fields that the page shows."""
        return {key: getattr(self, key) for key in ("what", "state", "done", "total", "message")}


Work = Callable[[BackgroundJob], str]
"""Does it, and says in words what was made."""


class BackgroundQueue:
    """The last job of each thing that was worked on."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._jobs: dict[str, BackgroundJob] = {}
        self._lock = Lock()

    def start(self, key: str, what: str, work: Work) -> None:
        """Start work on something, and cancel what is in progress on it."""
        job = BackgroundJob(what)
        with self._lock:
            if (old := self._jobs.get(key)) is not None:
                old.stop.set()
            self._jobs[key] = job
        self._pool.submit(_run_background_job, job, work)

    def cancel(self, key: str) -> None:
        """Cancel the work on something."""
        if (job := self._jobs.get(key)) is not None:
            job.stop.set()

    def job(self, key: str) -> BackgroundJob | None:
        """Return the last job."""
        return self._jobs.get(key)

    def close(self) -> None:
        """End everything, and wait until it has ended."""
        for job in list(self._jobs.values()):
            job.stop.set()
        self._pool.shutdown()


def _run_background_job(job: BackgroundJob, work: Work) -> None:
    try:
        job.report(0, 0)
        job.state = "running"
        job.message = work(job)
        job.state = "done"
    except CancelledError:
        job.state = "cancelled"
    except (GetagripError, OSError, MemoryError) as error:
        job.state, job.message = "failed", str(error)
    except Exception as error:  # nobody sees a thread's errors: the page shows them
        job.state, job.message = "failed", f"an error of the program: {type(error).__name__}: {error}"
    finally:
        return_freed_memory()


def return_freed_memory() -> None:
    """Give freed memory back to the system; glibc keeps most of it between the arrays that are still in use."""
    with suppress(AttributeError, OSError, TypeError):  # another library of C
        ctypes.CDLL(None).malloc_trim(0)


@dataclass(frozen=True)
class Estimator:
    """An estimator."""

    makes: Literal["masks", "hands"]
    script: str
    """Its script, for the advice on how to set it up."""
    words: str
    """Arguments of the script; a name in braces stands for values of the video, or a place to write to. Without values
    it is left out, with the option before it."""
    reader: str = ""
    """Tracker that reads its files (``import hands --from``); without one, they are masks or a hand file."""


ESTIMATORS = {
    "sam2": Estimator("masks", "sam_masks.py sam2", "{images} --box {box} --out {out}"),
    "sam3": Estimator("masks", "sam_masks.py sam3", "{images} --box {box} --text {word} --out {out}"),
    "hamer": Estimator(
        "hands", "hamer_hands.py", "{images} --side {side} --K {K} --boxes {boxes} --near {near} --out {hand}"
    ),
    "wilor": Estimator("hands", "wilor.py", "{images} --side {side} --K {K} --near {near} --out {hand}"),
    "hawor": Estimator("hands", "hawor_hands.py", "{images} --K {K} --out {out}", "hawor"),
}


def estimators_making(makes: str) -> tuple[str, ...]:
    """Return the names of the estimators that make ``masks`` or ``hands``."""
    return tuple(name for name, one in ESTIMATORS.items() if one.makes == makes)


def command_variable(name: str) -> str:
    """Return the environment variable that holds an estimator's command."""
    return f"GETAGRIP_{name.upper()}"


def setup_advice(name: str) -> str:
    """Say how to set an estimator up."""
    call = f"/environments/{name}/bin/python /scripts/{ESTIMATORS[name].script}"
    return f"{command_variable(name)}='{call}', see estimators.md"


def estimator_command(name: str) -> list[str] | None:
    """Return the words of an estimator's command; None where it is not set up.

    Raises ``UsageError`` for a command whose program or script is not there.
    """
    try:
        words = shlex.split(os.environ.get(command_variable(name), ""))
    except ValueError as error:
        raise UsageError(f"{command_variable(name)} must be a command ({error})") from error
    if not words:
        return None
    program = shutil.which(words[0])
    if program is None or any(word.endswith(".py") and not Path(word).is_file() for word in words):
        lost = words[0] if program is None else next(word for word in words if word.endswith(".py"))
        raise UsageError(f"{command_variable(name)} must be a command that is there (got {lost})")
    return [program, *(str(Path(word).absolute()) if word.endswith(".py") else word for word in words[1:])]


def check_estimator(name: str) -> None:
    """Raise ``UsageError`` for an estimator that is not set up."""
    if estimator_command(name) is None:
        raise UsageError(f"missing {command_variable(name)}: the command that runs {name}; {setup_advice(name)}")


def run_estimator(name: str, values: Mapping[str, Sequence[object]], out: Path) -> None:
    """Run an estimator, in the folder of its script; it writes into ``out``, which must exist.

    ``values`` are those of the names in its words. Raises ``UsageError`` with the last line that it printed where it
    fails or writes nothing.
    """
    check_estimator(name)
    words = estimator_command(name) or []
    values = {**values, "out": [out.absolute()], "hand": [out.absolute() / "hand.npz"]}
    for word in ESTIMATORS[name].words.split():
        known = not word.startswith("{") or word[1:-1] in values
        words += [word] if not word.startswith("{") else map(str, values.get(word[1:-1], ()))
        if not known:
            words.pop()  # its option
    where = next((Path(word).parent for word in words if word.endswith(".py")), None)
    print_note(f"{name}: {shlex.join(words)}")
    done = subprocess.run(words, cwd=where, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not any(out.iterdir()):
        said = ((done.stderr.strip() or done.stdout.strip()).splitlines() or ["it said nothing"])[-1]
        failed = f"failed with status {done.returncode}" if done.returncode else "wrote nothing"
        raise UsageError(f"{name} {failed}: {said}")


CLIPS_FOLDER, RESULTS_FOLDER = "clips", "results"
"""Folders beside the marks."""
REPORT_FILES = ("report.html", "report.png")
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

    def __str__(self) -> str:
        return self.mesh if self.size_mm is None else f"{self.mesh} of {self.size_mm:g} mm"


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


AddViews: TypeAlias = Callable[[Path], str]
"""Adds what further cameras see to a clip; returns what is to be known of it. Raises ``InputError``."""


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
    return job.run(ReportCall(result))


def result_folder(out: Path, name: str) -> Path:
    """Return the folder of a grasp's result."""
    return out / RESULTS_FOLDER / name


def reconstruct_grasp_files(
    new_clip: NewClipCall,
    shape: RequestedMesh,
    out: Path,
    name: str,
    job: BackgroundJob,
    depth: DepthFiles | None = None,
    views: AddViews | None = None,
) -> str:
    """Make the clip by ``new_clip`` with the mesh, and reconstruct it.

    Returns the outputs of ``clip new`` and ``reconstruct``, warnings about the clip first. Raises ``GetagripError``
    with the output of a command that failed, ``CancelledError``.
    """
    clip, result = files.folder_inside(out, CLIPS_FOLDER) / name, files.folder_inside(out, RESULTS_FOLDER) / name
    make = replace(new_clip, mesh=shape.mesh, size_mm=shape.size_mm, out=clip, overwrite=True, quiet=True)
    lost = f"depth images of the earlier {clip} are left out" if depth is None and (clip / DEPTH_KEY).exists() else ""
    steps: list[tuple[str, Callable[[], str]]] = [
        ("making the clip", lambda: job.run(make)),
        ("adding depth", lambda: lost if depth is None else depth.add_to(clip)),
        ("adding views", lambda: "" if views is None else views(clip)),
        ("reconstructing", lambda: job.run(ReconstructCall(clip, result.parent))),
    ]
    said = []
    for n, (what, work) in enumerate(steps):
        job.message = what
        job.report(n, len(steps))
        said.append(work())
    return "\n".join(filter(None, said))


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
    """Run a command in a process, and return its output as ``command_output`` does.

    Raises ``GetagripError`` for a command that failed, ``CancelledError`` once the job was cancelled.
    """
    process = subprocess.Popen(
        processes.python_command("-m", "getagrip", *words),
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
    return command_output(process.returncode, out, err)


def command_output(status: int, out: str, err: str) -> str:
    """Return the printed text of a command, warnings last. Raises ``GetagripError`` with it if the command failed."""
    if status not in SUCCESS_STATUSES:
        said = (err.strip() or out.strip() or "it ended early").splitlines()
        raise GetagripError("; ".join(line.removeprefix("getagrip: ") for line in said))
    return "\n".join(filter(None, (out.strip(), err.strip())))
