"""Processes: Ctrl-C ends the program quietly at any time, and child Pythons never import from the current folder."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import AbstractContextManager, chdir, nullcontext
from threading import current_thread, main_thread
from types import FrameType

PROGRAM_NAMES = ("getagrip", "getagrip.exe")
INTERRUPT_EXIT_STATUS = 130
"""Exit status after Ctrl-C."""
_interrupt_count = 0


def is_program() -> bool:
    """Return whether this process runs the command line, not a script that imports the package."""
    return os.path.basename(sys.argv[0] if sys.argv else "").lower() in PROGRAM_NAMES


def exit_on_interrupt() -> None:
    """End the process at once on Ctrl-C: imports, still running, would turn an interrupt into other errors."""
    _set_interrupt_handler(_exit_handler)


def raise_on_interrupt() -> None:
    """Raise ``KeyboardInterrupt`` on Ctrl-C, and count it."""
    _set_interrupt_handler(_raise_handler)


def restore_default_interrupt() -> None:
    """Let the system end the process on Ctrl-C, silently."""
    _set_interrupt_handler(signal.SIG_DFL)


def interrupt_count() -> int:
    """Return the number of interrupts since ``raise_on_interrupt``."""
    return _interrupt_count


def is_user_interrupt(error: BaseException, before: int) -> bool:
    """Return whether an error is the user's Ctrl-C, not raised by code, given the earlier ``interrupt_count``."""
    known = signal.getsignal(signal.SIGINT) in (_exit_handler, _raise_handler, signal.SIG_IGN)
    return isinstance(error, KeyboardInterrupt) and (_interrupt_count > before or not known)


def _set_interrupt_handler(handler: object) -> None:
    own = (signal.default_int_handler, _exit_handler, _raise_handler)
    if current_thread() is main_thread() and signal.getsignal(signal.SIGINT) in own:
        signal.signal(signal.SIGINT, handler)  # type: ignore[arg-type]


def _exit_handler(number: int, frame: FrameType | None) -> None:
    os.write(2, b"interrupted\n")
    os._exit(INTERRUPT_EXIT_STATUS)


def _raise_handler(number: int, frame: FrameType | None) -> None:
    global _interrupt_count  # noqa: PLW0603
    _interrupt_count += 1
    signal.default_int_handler(number, frame)


SAFE_PATH_ENVIRONMENT = {"PYTHONSAFEPATH": "1"}
"""Environment of child processes whose command a library writes, such as multiprocessing's."""


def python_command(*words: str) -> list[str]:
    """Return the command that runs this Python with arguments ``words``, such as ``-m`` and a module."""
    return [sys.executable, "-P", *words]


def imports_from_cwd() -> bool:
    """Return whether this process imports from the current folder, as a notebook does: the folder is trusted."""
    return bool({"", os.getcwd()} & {*sys.path})


def leave_cwd() -> AbstractContextManager[None]:
    """Leave the current folder within a ``with`` block, unless it is trusted (``imports_from_cwd``)."""
    return nullcontext() if imports_from_cwd() else chdir(os.sep)
