"""A reader in a child process, within limits of time and memory, watched for what no reader may do."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from getagrip.errors import GetagripError
from helpers.held_ball import write_mano

SHARED = Path(tempfile.mkdtemp(prefix="getagrip-fuzz-"))
"""MANO's files, and what is kept of them: made once, read and written by many."""


atexit.register(shutil.rmtree, SHARED, ignore_errors=True)


@dataclass(frozen=True)
class Reader:
    """One of them, as it is tried."""

    write: Callable[[Path], object]
    """Puts a valid input into an empty folder."""
    read: Callable[[Path], object]
    """Reads it. May raise ``GetagripError``."""
    writable: tuple[Path, ...] = (SHARED,)


def mano_folder() -> Path:
    """MANO's files, synthetic."""
    folder = SHARED / "mano"
    return folder if folder.exists() else write_mano(folder)


SECONDS, MEGABYTES = 10.0, 1200
"""Limits of a case, of processor time and memory: small inputs take milliseconds.

Arrays of a file may have 512 MB, and be copied once.
"""
CASES = 200
"""Of one process."""
Read = Callable[[Path], object]


@dataclass(frozen=True)
class Finding:
    """What is wrong with a case."""

    what: str
    """In a line, the same for the same fault."""
    details: str = ""


class Child:
    """A process that reads a folder again and again, and says what is wrong each time."""

    def __init__(self, read: Read, folder: Path, writable: tuple[Path, ...] = ()) -> None:
        self.arguments = read, folder, writable
        self._process: Any = None
        self._cases = 0

    def attempt(self, seconds: float = SECONDS) -> Finding | None:
        """What is wrong where the folder is read; None where that succeeds, or ends in an error for its user.

        Wrong is any other error, a warning, a death, more time or memory than allowed, code or other programs run, and
        files written outside the folder and ``writable``, or read beside the folder.
        """
        if self._process is None:
            self._start()
        self._cases += 1
        found: Finding | None
        try:
            self._pipe.send(None)
            if self._answers(seconds):
                found = self._pipe.recv()
            else:
                found = Finding(f"not done after {seconds:g} s", _stack(self._process.pid))
        except (EOFError, ConnectionError):
            self._process.join()
            found = Finding(f"the process died ({self._process.exitcode})")
        if found is not None or self._cases >= CASES:
            self.close()
        return found

    def _answers(self, seconds: float) -> bool:
        """Whether the process answers in so many seconds of a processor, or ten times as many on the wall."""
        end, most = time.monotonic() + 10.0 * seconds, _spent(self._process.pid) + seconds
        while not self._pipe.poll(min(seconds, 1.0)):
            if time.monotonic() > end or _spent(self._process.pid) > most:
                return False
        return True

    def close(self) -> None:
        """End the process; another ``attempt`` starts a new one."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            _stack_file(self._process.pid).unlink(missing_ok=True)
        self._process = None

    def _start(self) -> None:
        fork = multiprocessing.get_context("fork")
        self._pipe, theirs = fork.Pipe()
        self._process = fork.Process(target=_child, args=(*self.arguments, theirs), daemon=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # a fork beside threads of a library that sleep
            self._process.start()
        theirs.close()
        self._cases = 0


def _spent(pid: int) -> float:
    """The processor time of a process [s]: others may keep the machine busy."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _stack_file(pid: int) -> Path:
    return Path(tempfile.gettempdir()) / f"getagrip-fuzz-stack-{pid}"


def _stack(pid: int) -> str:
    """Where a process is, which writes that to a file when it is asked to."""
    path = _stack_file(pid)
    os.kill(pid, signal.SIGUSR1)
    for _ in range(50):
        if path.exists() and path.stat().st_size:
            return path.read_text("utf-8", "replace")
        time.sleep(0.02)
    return ""


def _child(read: Read, folder: Path, writable: tuple[Path, ...], parent: Connection) -> None:
    import faulthandler

    stack = _stack_file(os.getpid()).open("w")
    faulthandler.register(signal.SIGUSR1, stack)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEGABYTES * 2**20, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    sys.dont_write_bytecode = True
    home = (folder.resolve(), *(path.resolve() for path in writable))
    acts: list[str] = []
    sys.addaudithook(lambda event, args: acts.extend(_forbidden(event, args, home)))
    while True:
        parent.recv()
        del acts[:]
        parent.send(_watched(read, folder, acts))


def _watched(read: Read, folder: Path, acts: list[str]) -> Finding | None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            read(folder)
        except GetagripError as error:
            message = str(error)
            if "\n" in message or not message.isprintable() or len(message) > 5000:
                return Finding("a message of several lines, unprintable or endless", message)
        except BaseException as error:
            return Finding(f"{type(error).__name__} in {_place(error)}", traceback.format_exc())
    if acts:
        return Finding(acts[0], "\n".join(acts))
    if warned:
        it = warned[0]
        return Finding(f"{it.category.__name__} in {Path(it.filename).name}:{it.lineno}", str(it.message))
    return None


def _place(error: BaseException) -> str:
    """Where in this package an error arose: the innermost of its lines."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if f"{os.sep}getagrip{os.sep}" in frame.filename]
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "no line of the package"


RUNS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "pickle.find_class")
FILES = ("open", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.symlink", "os.link", "os.truncate")
"""Events of Python's audit."""


def _forbidden(event: str, args: tuple[Any, ...], home: tuple[Path, ...]) -> Iterator[str]:
    """What is wrong with an event of Python's audit, in words."""
    if event in RUNS:
        yield f"{event} {args[:2]!r}"
    if event in FILES and isinstance(args[0], str | bytes):
        below = event in ("os.remove", "os.rmdir") and args[1] >= 0  # a path below a folder that is open
        parent = os.readlink(f"/proc/self/fd/{args[1]}") if below else ""
        path = Path(os.path.realpath(os.path.join(parent, os.fsdecode(args[0]))))
        writes = event != "open" or bool((args[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC))
        inside = any(path.is_relative_to(each) for each in home)
        if writes and not inside and path != Path(os.devnull):
            yield f"{event} of a file outside"
        if path.is_relative_to(home[0].parent / "outside"):
            yield "a file outside was read"
