"""Which code made something: a fingerprint of the package's files, since they change within a version."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
ABOVE = (
    "cli", "commands", "annotate", "experiments", "batch", "pages", "film", "pictures", "export", "segmentation",
    "evaluation",
)  # fmt: skip
"""Parts that a reconstruction does not import: those above ``fitting`` (docs/architecture.md), but for ``timelines``,
where ``reconstruct`` is; and ``evaluation``."""


@cache
def fingerprint(*also: str) -> str:
    """Compute the checksum of all sources and tables that a reconstruction may depend on, 16 hexadecimal digits.

    What is made otherwise depends on more: ``also`` are the folders and files ``ABOVE`` that it depends on, relative to
    the package. It changes with a comment, too: that a change does not matter cannot be seen from outside.
    """
    total = hashlib.sha256()
    for path in sorted((*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.json"))):
        name = path.relative_to(PACKAGE).as_posix()
        if name.split("/")[0].removesuffix(".py") not in ABOVE or f"{name}/".startswith(
            tuple(f"{part}/" for part in also)
        ):
            content = path.read_bytes()
            total.update(f"{name}\0{len(content)}\0".encode())
            total.update(content)
    return total.hexdigest()[:16]
