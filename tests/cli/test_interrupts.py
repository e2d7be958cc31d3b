"""Ctrl-C: one quiet line whenever it comes, in the processes that are started as well."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from getagrip import __main__ as program
from getagrip import cli
from getagrip.io import processes
from helpers.environment import import_path

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
PRESS = "import os, signal; from getagrip.io import processes; processes.{0}(); os.kill(os.getpid(), signal.SIGINT)"
CUSTOM = """
import sys, time
from pathlib import Path
if any("spawn_main" in word for word in sys.orig_argv):
    Path({0!r}).touch()
    time.sleep(1.0)
    import fractions
"""


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(processes, "_interrupt_count", 0)
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("phase", "status", "said"),
    [
        ("exit_on_interrupt", 130, "interrupted\n"),
        ("restore_default_interrupt", -signal.SIGINT, ""),
        ("raise_on_interrupt", None, ""),
    ],
)
def test_what_it_does_depends_on_the_phase(phase: str, status: int | None, said: str) -> None:
    done = subprocess.run([sys.executable, "-c", PRESS.format(phase)], capture_output=True, text=True, check=False)
    if status is None:
        assert done.stderr.endswith("KeyboardInterrupt\n")
    else:
        assert (done.returncode, done.stderr) == (status, said)


def test_another_error_that_libraries_make_of_it_is_told_as_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def swallowed() -> int:
        processes.raise_on_interrupt()
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise RuntimeError("Error calling __set_name__") from None
        return 0

    monkeypatch.setattr(cli, "main", swallowed)
    monkeypatch.setattr(sys, "argv", ["/usr/bin/getagrip"])
    assert program.main() == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL


def test_an_error_without_an_interrupt_stays_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "main", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        program.main()


@pytest.mark.slow
def test_processes_that_are_still_starting_do_not_hear_it(tmp_path: Path) -> None:
    started = tmp_path / "started"
    (tmp_path / "sitecustomize.py").write_text(CUSTOM.format(str(started)))
    code = "from getagrip.batch.executor import run_in_processes; list(run_in_processes(len, ['a'], 1))"
    env = import_path()
    env["PYTHONPATH"] += f"{os.pathsep}{tmp_path}"
    with subprocess.Popen(
        [sys.executable, "-c", f"try:\n    {code}\nexcept KeyboardInterrupt:\n    print('interrupted')"],
        env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as parent:  # fmt: skip
        for _ in range(600):
            if started.exists():
                break
            time.sleep(0.05)
        os.killpg(parent.pid, signal.SIGINT)
        out, err = parent.communicate(timeout=60)
    assert (out, err) == ("interrupted\n", "")
