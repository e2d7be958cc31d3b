"""Libraries that not everybody has: each belongs to an extra of the package."""

from __future__ import annotations

import importlib
from typing import Any

from getagrip.errors import UsageError


def load(module: str, extra: str, option: str = "") -> Any:
    """Import a module of an extra of this package.

    Raises ``UsageError`` that says how to install it.

    ``option`` is what asks for it; empty: ``--to`` and the extra's name.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UsageError(
            f"missing module {module!r} ({error}): {option or f'--to {extra}'} needs it; "
            f"pip install 'getagrip[{extra}]'"
        ) from error
