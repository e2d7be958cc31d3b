"""The type of the fixture ``run``."""

from __future__ import annotations

from collections.abc import Callable

Run = Callable[..., tuple[int, str, str]]
"""Call the command line with some arguments; returns the exit status, stdout and stderr."""
