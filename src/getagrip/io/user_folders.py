"""The user's own folders, for what is neither input nor result."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from getagrip.errors import UsageError


def cache_folder() -> Path:
    """Return the folder of what can be made again. Raises ``UsageError`` where the user has none."""
    return _xdg_folder("XDG_CACHE_HOME", ".cache")


def state_folder() -> Path:
    """Return the folder of what is worth keeping. Raises ``UsageError`` where the user has none."""
    return _xdg_folder("XDG_STATE_HOME", ".local/state")


def _xdg_folder(variable: str, below_home: str) -> Path:
    try:
        return Path(os.environ.get(variable) or Path.home() / below_home) / "getagrip"
    except RuntimeError as error:  # as in a container, for a user whom it does not know
        raise UsageError(f"missing HOME or {variable}: this user has no home folder") from error


def is_private_folder(folder: Path) -> bool:
    """Return whether nobody but this user and root can write into a folder, or put another one in its place."""
    if os.name == "nt":
        return True
    whole, real = folder.absolute(), folder.resolve()
    return all(_is_protected_path(path, path == real) for path in {whole, *whole.parents, real, *real.parents})


def _is_protected_path(path: Path, last: bool) -> bool:
    """Return whether nobody else can exchange what a path leads to; nor, of the ``last`` folder, add to it."""
    try:
        about = path.lstat()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    if about.st_uid not in (0, os.geteuid()):
        return False
    writers = stat.S_IWOTH | (0 if _is_private(about.st_gid, about.st_uid) else stat.S_IWGRP)
    kept = bool(about.st_mode & stat.S_ISVTX) and not last  # where only the owner of an entry removes it
    return stat.S_ISLNK(about.st_mode) or kept or not about.st_mode & writers


def _is_private(group: int, owner: int) -> bool:
    """Return whether a group has its owner alone, as where each user has one of the same name."""
    try:
        import grp
        import pwd

        of, name = grp.getgrgid(group), pwd.getpwuid(owner).pw_name
    except (ImportError, KeyError):
        return False
    return of.gr_name == name and {*of.gr_mem} <= {name}
