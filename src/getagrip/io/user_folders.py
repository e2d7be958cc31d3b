"""The user's own folders, for what is neither input nor result."""

from __future__ import annotations

import os
from pathlib import Path

from getagrip.errors import UsageError


def cache_folder() -> Path:
    """Return the folder of what can be made again. Raises ``UsageError`` where the user has none."""
    return _folder("XDG_CACHE_HOME", ".cache")


def state_folder() -> Path:
    """Return the folder of what is worth keeping. Raises ``UsageError`` where the user has none."""
    return _folder("XDG_STATE_HOME", ".local/state")


def _folder(variable: str, below_home: str) -> Path:
    try:
        return Path(os.environ.get(variable) or Path.home() / below_home) / "getagrip"
    except RuntimeError as error:  # as in a container, for a user whom it does not know
        raise UsageError(f"missing HOME or {variable}: this user has no home folder") from error
