"""Interrupts of the program by Ctrl-C: quiet whenever they come, and known from what code of others raises."""

from __future__ import annotations

import os
import signal
import sys
from threading import current_thread, main_thread
from types import FrameType

PROGRAM = ("getagrip", "getagrip.exe")
STATUS = 130
"""Exit status of a program that was interrupted."""
_times = 0


def is_program() -> bool:
    """Return whether this process was started as the program, and not to use the package."""
    return os.path.basename(sys.argv[0] if sys.argv else "").lower() in PROGRAM


def while_loading() -> None:
    """End the process at once from now on: nothing is done yet, and imports make other errors of an interrupt."""
    _set(_end)


def while_working() -> None:
    """Raise ``KeyboardInterrupt`` from now on, and count it."""
    _set(_raise)


def while_ending() -> None:
    """Let the system end the process from now on, without a word."""
    _set(signal.SIG_DFL)


def times() -> int:
    """Return how often the user has interrupted ``while_working``."""
    return _times


def is_pressed(error: BaseException, before: int) -> bool:
    """Return whether an error is the user's interrupt, given the ``times`` before it; else code of others raised it."""
    known = signal.getsignal(signal.SIGINT) in (_end, _raise, signal.SIG_IGN)
    return isinstance(error, KeyboardInterrupt) and (_times > before or not known)


def _set(handler: object) -> None:
    own = (signal.default_int_handler, _end, _raise)
    if current_thread() is main_thread() and signal.getsignal(signal.SIGINT) in own:
        signal.signal(signal.SIGINT, handler)  # type: ignore[arg-type]


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, b"interrupted\n")
    os._exit(STATUS)


def _raise(number: int, frame: FrameType | None) -> None:
    global _times  # noqa: PLW0603
    _times += 1
    signal.default_int_handler(number, frame)
