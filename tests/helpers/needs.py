"""Libraries that few tests use. Only those tests import them: what a file of tests imports, every process imports."""

from __future__ import annotations

from importlib.util import find_spec

import pytest


def needs(library: str, extra: str | None = None) -> pytest.MarkDecorator:
    """Skip where a library is absent, which an extra of the package brings."""
    advice = f": pip install -e '.[{extra}]'" if extra else ""
    return pytest.mark.skipif(find_spec(library) is None, reason=f"{library} is not installed{advice}")
