"""Which code made something: a fingerprint of the package's files, since they change within a version; the commit."""

from __future__ import annotations

import hashlib
import subprocess
from datetime import date
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
UNFINGERPRINTED_PARTS = (
    "cli", "commands", "annotate", "experiments", "batch", "pages", "film", "pictures", "export", "segmentation",
    "evaluation", "notebook", "reproduction",
)  # fmt: skip
"""Parts that a reconstruction does not import: those above ``fitting`` (docs/architecture.md), but for ``timelines``,
where ``reconstruct`` is; and ``evaluation``."""


@cache
def fingerprint(*also: str) -> str:
    """Compute the checksum of all sources and tables that a reconstruction may depend on, 16 hexadecimal digits.

    What is made otherwise depends on more: ``also`` are the folders and files ``UNFINGERPRINTED_PARTS`` that it depends on, relative to
    the package. It changes with a comment, too: that a change does not matter cannot be seen from outside.
    """
    total = hashlib.sha256()
    for path in sorted((*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.json"))):
        name = path.relative_to(PACKAGE).as_posix()
        if name.split("/")[0].removesuffix(".py") not in UNFINGERPRINTED_PARTS or f"{name}/".startswith(
            tuple(f"{part}/" for part in also)
        ):
            content = path.read_bytes()
            total.update(f"{name}\0{len(content)}\0".encode())
            total.update(content)
    return total.hexdigest()[:16]


def date_and_commit() -> str:
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
