"""When numbers were made, and by which code."""

from __future__ import annotations

import subprocess
from datetime import date
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def stamp() -> str:
    """Return the date and, in a git checkout, the package's commit: "2025-03-01, commit a1b2c3d".

    The commit is marked where files of the package differ from it.
    """
    today = date.today().isoformat()
    found = commit(PACKAGE)
    return f"{today}, commit {found}" if found else today


def commit(folder: Path) -> str | None:
    """Return the commit of a folder, marked if its files have changed; None if git does not have it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if not git("ls-files", "."):  # ignored: installed into an environment within another checkout
            return None
        changed = git("status", "--porcelain", "--", ".")
        return git("rev-parse", "--short", "HEAD") + (" with uncommitted changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):  # no git, or no checkout
        return None
