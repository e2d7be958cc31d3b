"""Install a wheel into a fresh environment and use it there, far from the clone: ``python scripts/try_wheel.py WHEEL``.

Runs ``getagrip demo``, the Python of README, the cells of the notebook, whose result must be right, and ``getagrip
doctor``; says how many seconds of processor time the first result took, kernels compiled. Where packages come from is
pip's own configuration.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 5.0
"""Maximum error of the notebook's result [mm]."""
README, NOTEBOOK = ROOT / "README.md", ROOT / "examples" / "getagrip.ipynb"


def main(wheel: Path) -> None:
    """Try the wheel; the first failing command ends the script."""
    with tempfile.TemporaryDirectory() as scratch:
        venv.create(Path(scratch) / "venv", with_pip=True)
        programs = Path(scratch) / "venv" / ("Scripts" if os.name == "nt" else "bin")
        # An environment without the clone, the user's settings, and compiled kernels.
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA_"))}
        environment |= {
            "XDG_CACHE_HOME": str(Path(scratch) / "cache"),
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        }

        def run(*words: str) -> None:
            print("$", *words[:4], flush=True)
            subprocess.run([programs / words[0], *words[1:]], cwd=scratch, env=environment, check=True)

        run("python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(wheel.resolve()))
        before = os.times()
        run("getagrip", "demo", "--out", "demo")
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        print(
            f"getagrip demo, kernels compiled: {spent:.1f} s of processor time, {after.elapsed - before.elapsed:.1f} s"
        )
        assert (Path(scratch) / "demo" / "report.html").is_file()
        blocks = re.findall(r"^```python run\n(.*?)^```$", README.read_text("utf-8"), re.MULTILINE | re.DOTALL)
        assert blocks
        for block in blocks:
            run("python", "-c", block)
        cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        run("python", "-c", f'{code}\nassert evaluation.metrics["add_mm"] < {LARGEST}, evaluation')
        assert (Path(scratch) / "mug-in-hand" / "about.json").is_file()
        run("getagrip", "doctor")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
