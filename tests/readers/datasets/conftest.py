"""MANO's files for the datasets whose hands are MANO's."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.held_ball import write_mano


@pytest.fixture(scope="session")
def mano_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of small files like MANO's, in which nothing may be changed."""
    return write_mano(tmp_path_factory.mktemp("mano") / "files")


@pytest.fixture
def mano(mano_files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same; what is cached of them is shared by all tests, and by nothing else."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(mano_files.parent / "cache"))  # names are checksums
    return mano_files
