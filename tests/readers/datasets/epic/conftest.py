from __future__ import annotations

from pathlib import Path

import pytest

from helpers.epic_files import write_epic


@pytest.fixture
def epic_folder(tmp_path: Path) -> Path:
    """A table of one grasp, VISOR's dense and sparse annotations of it, and EPIC's images."""
    return write_epic(tmp_path / "epic")
