"""The current folder may be a stranger's: no Python that we start runs what lies there."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from getagrip.io.plugins import PACKAGE
from helpers.environment import import_path

NAMES = ("getagrip", "pip", "numpy", "signal", "pickle", "threading", "socket", "runpy", "helpers", "submitit")
"""Modules that a process loads early."""
STARTED = {
    "a command of the page": (
        "from types import SimpleNamespace; from getagrip.studio.jobs import run_command; "
        "assert run_command(['--version'], SimpleNamespace(done=0, total=0, report=print)).startswith('getagrip ')"
    ),
    "pip": (
        "from getagrip.studio.hands import networks; from pathlib import Path; "
        "networks._download_wheel(Path({folder!r}))"
    ),
    "processes of a batch": (
        "from getagrip.batch.executor import run_in_processes; "
        "assert [*run_in_processes(len, ['abc'], 1)] == [('abc', 3)]"
    ),
}


@pytest.fixture
def sent(tmp_path: Path) -> Path:
    """A folder with modules that tell when they are run."""
    folder = tmp_path / "sent"
    for name in NAMES:
        (folder / name).mkdir(parents=True)
        for file in ("__init__.py", "__main__.py"):
            (folder / name / file).write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write('{name} ')\n")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("what", STARTED)
def test_nothing_of_the_current_folder_is_run(sent: Path, tmp_path: Path, what: str) -> None:
    script = tmp_path / "elsewhere" / "script.py"  # a script's own folder takes the place of the current one
    script.parent.mkdir()
    code = STARTED[what].format(folder=str(tmp_path))
    script.write_text(f"if __name__ == '__main__':\n    {code}\n")
    env = import_path() | {"PIP_NO_INDEX": "1"}
    done = subprocess.run([sys.executable, script], cwd=sent, env=env, capture_output=True, text=True, check=False)
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()
    assert done.returncode == 0 or (what == "pip" and "pip could not download" in done.stderr), done.stderr


@pytest.mark.skipif(find_spec("submitit") is None, reason="needs submitit: pip install -e '.[slurm]'")
def test_nor_does_a_task_of_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from getagrip.batch.clusters import SlurmExecutor
    from getagrip.batch.scheduling import NO_LIMITS

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("shutil.which", lambda name: name)
    executor = SlurmExecutor(1, len, NO_LIMITS, None)
    assert f"{sys.executable} -P" in executor._executor._executor.python
    executor.close()


def test_one_function_names_our_python() -> None:
    asked = {path.name for path in PACKAGE.rglob("*.py") if "sys.executable" in path.read_text("utf-8")}
    assert asked == {"processes.py", "compiling.py"}  # the latter looks whether it is a Python
