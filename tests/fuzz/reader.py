"""A reader as it is tried, and what all of them share."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
