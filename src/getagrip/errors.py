"""Every error that the package raises on purpose; the command line turns each into one line."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

MAX_QUOTED_CHARACTERS = 500
"""Characters that a message says of what was given: parsers quote the whole of what they do not understand."""


def escape_unprintable(text: str, kept: str = "") -> str:
    """Escape unprintable characters, as Python does, so that a text moves no cursor and colours nothing on a terminal.

    ``kept`` are characters that stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else ascii(c)[1:-1] for c in text)


def replace_surrogates(text: str) -> str:
    """Replace bytes of file names that are no UTF-8, so that a page or a table can hold the text."""
    return re.sub("[\ud800-\udfff]", "\ufffd", text)


class GetagripError(Exception):
    """Base class of all errors that a user can cause. The message names the culprit, its value and what is allowed."""


class UsageError(GetagripError):
    """The call itself is wrong (exit status 2)."""


class MissingOptionError(UsageError):
    """An option that the input needs is missing."""


def unknown_choice_error(what: str, got: object, known: Iterable[object]) -> UsageError:
    """Make the error for a name that is none of those known."""
    return UsageError(f"unknown {what} {got!r}; choose from {', '.join(map(str, known))}")


class InputError(GetagripError):
    """A file is missing, malformed or holds impossible values (exit status 1).

    The message, on one line, reads ``<file>: <key> must be <expected> (got <given>)``, with advice behind a semicolon;
    ``<file>: missing <key>``; or ``<key> cannot be used with ...``, if ``expected`` begins with "none with".
    """

    def __init__(self, path: str | Path, key: str, got: str, expected: str) -> None:
        self.path, self.key, self.got, self.expected = Path(path), key, got, expected
        short = got if len(got) <= MAX_QUOTED_CHARACTERS else f"{got[:MAX_QUOTED_CHARACTERS]}..."
        super().__init__(escape_unprintable(" ".join(f"{path}{_describe_mismatch(key, short, expected)}".split())))


MISSING_VALUE_TEXTS = ("nothing", "no such key", "no such array")
"""Values given where something that has a name is missing."""


def _describe_mismatch(key: str, got: str, expected: str) -> str:
    """Return the second half of a message about a file: the key, the value and what is expected."""
    verb = "needs" if re.match(r"some\b|one (at least|for each)", expected) else "must be"
    named = f": {key}" if key else ""
    if got in MISSING_VALUE_TEXTS or got.startswith("no "):
        asked = "" if expected in ("it", "the key", "the array") else f"; {verb} {expected}"
        return f": missing {key}{asked}" if key and got in MISSING_VALUE_TEXTS else f"{named}: {got}{asked}"
    if expected.startswith(("none with ", "none without ")):
        return f"{named} cannot be used {expected.removeprefix('none ')}"
    allowed, semicolon, advice = expected.partition("; ")
    return f"{named} {verb} {allowed} (got {got}){semicolon}{advice}"
