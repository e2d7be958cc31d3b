"""The examples run as they stand, and so does the Python in the README."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.paths import DATA, ROOT, needs

EXAMPLES = {path.name[:2]: path for path in sorted((ROOT / "examples").glob("*.py"))}


def run(code: str | Path, folder: Path, *args: object) -> str:
    """What a script prints that is run in a folder of its own."""
    command = [sys.executable, *(["-c", code] if isinstance(code, str) else [str(code)]), *map(str, args)]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def number_after(label: str, text: str) -> float:
    """The first number after a label in a text."""
    found = re.search(re.escape(label) + r"\s*([-\d.]+)", text)
    assert found, text
    return float(found[1])


def test_they_are_numbered() -> None:
    assert sorted(EXAMPLES) == ["01", "02", "03", "04", "05"]


@pytest.mark.slow
def test_a_synthetic_clip(tmp_path: Path) -> None:
    out = run(EXAMPLES["01"], tmp_path, "out")
    assert number_after("mask IOU", out) > 0.95
    assert (tmp_path / "out" / "report.png").stat().st_size > 10_000


@pytest.mark.slow
def test_own_arrays(tmp_path: Path) -> None:
    assert number_after("mask IOU", run(EXAMPLES["02"], tmp_path, "out")) > 0.9
    assert (tmp_path / "out" / "poses.npz").is_file()


def test_a_dataset_that_is_absent_is_skipped(tmp_path: Path) -> None:
    assert run(EXAMPLES["03"], tmp_path, "nowhere").startswith("skipped: name the folder")


@pytest.mark.slow
@needs(DATA / "dexycb")
def test_a_real_dataset(tmp_path: Path) -> None:
    assert number_after("mask IOU", run(EXAMPLES["03"], tmp_path, DATA / "dexycb", DATA / "ycb")) > 0.9


@pytest.mark.slow
def test_a_method_of_ones_own_in_the_benchmark(tmp_path: Path) -> None:
    assert "coarse-static" in run(EXAMPLES["04"], tmp_path, "out")
    assert "coarse-static" in (tmp_path / "out" / "methods.md").read_text()


@pytest.mark.slow
def test_an_energy_term_of_ones_own(tmp_path: Path) -> None:
    out = run(EXAMPLES["05"], tmp_path)
    usual, level = (number_after(f"{label}: axis", out) for label in ("soft hinge", "Level soft hinge"))
    assert level < usual


@pytest.mark.slow
def test_the_python_in_the_readme(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    run(code, tmp_path)
    assert (tmp_path / "report.png").is_file()
