"""Python in processes of our own: none imports from the current folder, which somebody else may have sent."""

from __future__ import annotations

import os
import sys
from contextlib import AbstractContextManager, chdir, nullcontext

SAFE = {"PYTHONSAFEPATH": "1"}
"""Environment of processes whose command other code writes, such as multiprocessing's."""


def command(*words: str) -> list[str]:
    """Return the command that runs this Python with ``words``, as ``-m`` and a module."""
    return [sys.executable, "-P", *words]


def elsewhere() -> AbstractContextManager[None]:
    """Leave the current folder for a while, unless this process itself imports from it, as in a notebook."""
    return nullcontext() if {"", os.getcwd()} & {*sys.path} else chdir(os.sep)
