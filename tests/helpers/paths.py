"""Where the checkout is, and the folder of data beside it that only some machines have."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where some of ``DATA`` is absent."""
    return pytest.mark.skipif(not path.exists(), reason=f"needs {path.relative_to(ROOT.parent)} beside the checkout")
