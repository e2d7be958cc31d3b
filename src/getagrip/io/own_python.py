"""Python in processes of our own: none imports from the current folder, which somebody else may have sent."""

from __future__ import annotations

import os
import sys
from contextlib import AbstractContextManager, chdir, nullcontext

SAFE_PATH_ENVIRONMENT = {"PYTHONSAFEPATH": "1"}
"""Environment of processes whose command other code writes, such as multiprocessing's."""


def python_command(*words: str) -> list[str]:
    """Return the command that runs this Python with ``words``, as ``-m`` and a module."""
    return [sys.executable, "-P", *words]


def imports_from_cwd() -> bool:
    """Return whether this process itself imports from the current folder, as in a notebook: it is the user's own."""
    return bool({"", os.getcwd()} & {*sys.path})


def leave_cwd() -> AbstractContextManager[None]:
    """Leave the current folder for a while, unless it is the user's own."""
    return nullcontext() if imports_from_cwd() else chdir(os.sep)
