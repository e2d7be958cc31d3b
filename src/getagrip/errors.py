"""Every error that the package raises on purpose; the command line turns each into one line."""

from __future__ import annotations

from pathlib import Path


class GetagripError(Exception):
    """Root of all errors a user can cause. The message names the culprit, what was given and what is allowed."""


class UsageError(GetagripError):
    """The call itself is wrong (exit status 2)."""


class InputError(GetagripError):
    """A file is missing, malformed or holds impossible values (exit status 1).

    The message reads ``<file>: <key>: got <given>, expected <expected>``, on one line.
    """

    def __init__(self, path: str | Path, key: str, given: str, expected: str) -> None:
        self.path, self.key, self.given, self.expected = Path(path), key, given, expected
        where = f"{path}: {key}" if key else f"{path}"
        super().__init__(" ".join(f"{where}: got {given}, expected {expected}".split()))
