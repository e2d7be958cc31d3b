"""The program as a process: how it starts, where its output goes, how it is interrupted."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from typing import Any

import pytest

import getagrip
from getagrip import __main__
from getagrip.cli import main
from helpers.environment import ROOT, Run


def test_an_interrupt_while_modules_load_leaves_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    class Interrupted:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "getagrip.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "getagrip.cli")
    monkeypatch.delattr(getagrip, "cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert __main__.main() == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_the_program_is_installed_with_it() -> None:
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert content["project"]["scripts"] == {"getagrip": "getagrip.__main__:main"}


@pytest.mark.slow
def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys, getagrip\n"
        "from getagrip.cli import main\n"
        "try: main(['reconstruct', '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'scipy', 'trimesh', 'cv2', 'matplotlib', 'igl'} & set(sys.modules)\n"
        "sys.exit(','.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_version_is_printed(run: Run) -> None:
    assert run("--version")[:2] == (0, f"getagrip {getagrip.__version__}\n")


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_closed_output_is_no_error(closed: str, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(sys, closed, None)
    for args, status in ((["--help"], 0), (["reconstrct"], 2), (["evaluate", "none"], 1)):
        try:
            found = main(args)
        except SystemExit as exit_:
            found = int(exit_.code or 0)
        assert found == status
    getattr(sys, closed).close()
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_reader_that_leaves_ends_the_command_quietly() -> None:
    command = [sys.executable, "-m", "getagrip", "init", "learn", "--help"]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 141
