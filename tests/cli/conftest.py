"""What a clip is made of."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.results import write_inputs


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A folder with a video, masks of it, a mesh in a generator's unit, and hands in some of its frames."""
    return write_inputs(tmp_path)
