"""The words that name a command, checked before its options, each of which would be reported as unknown with it."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches

from getagrip.errors import cleaned, unknown


def joined(words: Sequence[str], names: Collection[str], before: str = "") -> list[str]:
    """Join the words that name a command into one.

    Ends the process where they name none.

    ``names`` are the commands, of one word or two, and ``before`` is the command whose subcommands they are.
    """
    if not words or words[0].startswith("-"):
        return list(words)
    for length in (2, 1):
        if (name := " ".join(words[:length])) in names:
            return [name, *words[length:]]
    begun = [name for name in names if name.split()[0] == words[0]]
    if begun and {"-h", "--help"} & {*words}:
        return [begun[0], "--help"]
    value = " ".join(words[:2]) if begun else words[0]
    alike = [before + name for name in begun or _alike(value, names)]
    print(f"getagrip: {cleaned(str(unknown('command', before + value, alike or names)))}", file=sys.stderr)
    sys.exit(2)


def _alike(word: str, names: Iterable[str]) -> list[str]:
    """Return the names that begin with a word or, if there is none, the one most like it."""
    spelt = {spelling: name for name in names for spelling in (name, name.split()[0])}
    alike = [name for name in spelt if name.startswith(word)] or get_close_matches(word, spelt, n=1)
    return [*dict.fromkeys(spelt[name] for name in alike)]
