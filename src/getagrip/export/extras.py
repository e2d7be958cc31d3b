"""Libraries of other programs, which not everybody has."""

from __future__ import annotations

import importlib
from typing import Any

from getagrip.errors import UsageError


def load(module: str, extra: str) -> Any:
    """A module of an extra of this package. Raises ``UsageError`` that says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UsageError(
            f"--to {extra}: got no module {module!r} ({error}), expected it: pip install 'getagrip[{extra}]'"
        ) from error
