"""MANO's files for the datasets whose hands are MANO's."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.held_ball import write_mano


@pytest.fixture
def mano(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of small files like MANO's; what is cached of them is shared by all tests, and by nothing else."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))  # names are checksums
    return write_mano(tmp_path / "mano")
