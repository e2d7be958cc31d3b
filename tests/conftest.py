"""Fixtures for all tests. Shapes in type hints are checked while they run, and only then."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

from helpers.shapes import check_package, next_file

MEMORY = Path("/dev/shm")
"""Files in memory, on Linux."""
ROOM = 2**30
"""What must be free there [bytes]: many times what the tests have in it at once."""


def room_in_memory() -> bool:
    """Whether all that a test may write, and run, has its place there."""
    if not os.access(MEMORY, os.W_OK):
        return False
    there = os.statvfs(MEMORY)
    return there.f_bavail * there.f_frsize >= ROOM and not there.f_flag & os.ST_NOEXEC


if "TMPDIR" not in os.environ and room_in_memory():  # databases, of which many tests make one, wait for a disk
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background jobs; tests send it
    signal.signal(signal.SIGINT, signal.default_int_handler)

gc.disable()  # until all tests are collected, since what is made until then stays
check_package()  # before anything of the package is imported

# The same examples on every machine, however busy it is.
settings.register_profile(
    "here", deadline=None, max_examples=20, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("here")

from getagrip.cli import main  # noqa: E402
from getagrip.clip import write_clip  # noqa: E402
from helpers.annotation import Chromium  # noqa: E402
from helpers.clips import small_clip  # noqa: E402
from helpers.environment import Run  # noqa: E402
from helpers.folders import FullDisk  # noqa: E402
from helpers.scenes import SHORT, scene  # noqa: E402


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest tests first."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


def pytest_collection_finish() -> None:
    """What is there by now stays until the end: the garbage collector need not look at it again and again.

    For the rest it comes more seldom than usual, after so many new objects.
    """
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.fixture(autouse=True, scope="module")
def _shapes_are_checked_anew() -> None:
    next_file()


@pytest.fixture(scope="session")
def written_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small clip in a folder in which nothing may be changed."""
    return write_clip(*small_clip(), tmp_path_factory.mktemp("written") / "small")


@pytest.fixture(scope="session")
def can_and_box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two synthetic clips, a can and a box, in which nothing may be changed."""
    folder = tmp_path_factory.mktemp("can_and_box") / "clips"
    for category in ("can", "box"):
        write_clip(*scene(category, 0, SHORT), folder / category)
    return folder


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chromium]:
    """What starts a browser at the first test of this process that asks for one."""
    made = Chromium()
    yield made
    made.close()


@pytest.fixture
def browser(chromium: Chromium) -> Any:
    """A browser that answers, the same for all tests while it lives."""
    return chromium.get()


@pytest.fixture
def users_hints() -> Iterator[None]:
    """As a user has it: type hints are not checked while the test runs."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def clip_folder(written_clip: Path, tmp_path: Path) -> Path:
    """The small clip in a folder that a test may break."""
    return shutil.copytree(written_clip, tmp_path / "small")


@pytest.fixture
def refused(tmp_path: Path) -> Callable[..., str]:
    """Assert that reading raises an InputError of one line with certain words; returns the line."""
    from getagrip.errors import InputError

    def check(read: Callable[[], object], *words: str) -> str:
        with pytest.raises(InputError) as caught:
            read()
        message = str(caught.value)
        assert "\n" not in message
        assert any(form in message for form in (" must be ", " needs ", "missing ", " cannot be used "))
        for word in words:
            assert word in message
        return message

    return check


@pytest.fixture
def full_disk() -> FullDisk:
    """Within it no file grows beyond so many bytes: a write stores a part, and then fails, as on a full disk."""
    resource = pytest.importorskip("resource")

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Call the command line; returns the exit status, stdout and stderr."""

    def call(*args: object) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            status = main([str(arg) for arg in args])
        except SystemExit as exit_:
            status = int(exit_.code or 0)
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err or "--debug" in args
        return status, out, err

    return call
