"""Systems without POSIX (Windows) or Linux's own calls: everything can be imported, and what is missing is said."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from getagrip.batch.scheduling import Limits
from getagrip.errors import UsageError
from getagrip.io import files, terminal

WITHOUT_POSIX = """
import importlib, os, pkgutil, sys, tempfile
import cv2, igl, matplotlib.pyplot, numba, scipy.optimize, scipy.spatial, trimesh, rich.progress, tyro, av
for name in ("fcntl", "resource", "pwd", "grp", "termios", "posix"):
    sys.modules[name] = None
for name in ("fork", "sched_getaffinity", "getuid", "getloadavg", "mkfifo", "O_NOFOLLOW", "O_DIRECTORY"):
    if hasattr(os, name):
        delattr(os, name)
import getagrip
for module in pkgutil.walk_packages(getagrip.__path__, "getagrip."):
    if module.name != "getagrip.__main__":
        importlib.import_module(module.name)
from pathlib import Path
from getagrip.batch.executor import available_cores
from getagrip.cli.doctor import _check_machine
from getagrip.io import files
assert available_cores() >= 1
with files.hold_lock(Path(tempfile.gettempdir())):
    pass
print(files.HAS_FILE_LOCKS, *(words for state, words in _check_machine() if state == "without"), sep="; ")
"""


@pytest.mark.slow
def test_every_module_can_be_imported_without_posix_and_doctor_says_what_is_missing() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_POSIX], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("False; ")
    assert "locks on files" in done.stdout


def test_letters_that_an_output_lacks_are_escaped() -> None:
    command = [sys.executable, "-m", "getagrip", "--help"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert b"reconstruct" in done.stdout
    assert done.stdout.isascii()


def test_a_user_without_a_home_is_asked_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container that does not know the user."""

    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", home)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    with pytest.raises(UsageError, match="missing HOME or XDG_CACHE_HOME"):
        terminal.cache_folder()
    monkeypatch.setenv("XDG_CACHE_HOME", "kept")
    assert terminal.cache_folder() == Path("kept/getagrip")


@pytest.mark.parametrize("platform", ["darwin", "win32"])
def test_a_limit_of_memory_is_refused_where_the_system_has_none(monkeypatch: pytest.MonkeyPatch, platform: str) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    Limits(seconds=1.0)
    with pytest.raises(UsageError, match=f"--limit-gb cannot be used with {platform}"):
        Limits(gigabytes=1.0)


@pytest.mark.parametrize("name", ["CON", "nul.json", "Com1", "lpt9.tar.gz", "mug.", "aux.", "COM¹"])
def test_names_that_windows_cannot_have_are_no_plain_names(name: str) -> None:
    assert not files.is_portable_name(name)


@pytest.mark.parametrize("name", ["console", "nullified.json", "com10", "a.con", "mug.0", "Größe"])
def test_names_that_only_look_like_them_are(name: str) -> None:
    assert files.is_portable_name(name)


def test_letters_that_windows_forbids_are_forbidden_there() -> None:
    assert (":" in files.FORBIDDEN_NAME_CHARS) == (os.name == "nt")
