"""MANO files for the tests of trackers."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.hand_files import write_mano_files


@pytest.fixture(scope="session")
def mano_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MANO files of the published layout, the left hand the right one's mirror image, its fault included."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        return write_mano_files(tmp_path_factory.mktemp("mano"), monkeypatch)


@pytest.fixture
def mano_folder(mano_files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing may be changed in it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(mano_files / "cache"))
    return mano_files
