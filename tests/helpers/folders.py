"""What a folder holds, and a disk that is full."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

FullDisk = Callable[[int], AbstractContextManager[None]]


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, hidden ones too: their bytes by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def results_in(folder: Path) -> list[Path]:
    """The result folders in a folder, sorted."""
    return sorted(path.parent for path in folder.glob("*/result.json"))
