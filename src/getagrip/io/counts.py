"""Numbers of things in words."""

from __future__ import annotations


def counted(number: int, thing: str, things: str = "") -> str:
    """Write a count, such as "1 clip" or "2 clips"; ``things`` is the plural where it takes more than an s."""
    return f"{number} {thing if number == 1 else things or f'{thing}s'}"
