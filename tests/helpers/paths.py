"""Where the checkout is, and the folder of data beside it that only some machines have."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where some of ``DATA`` is absent."""
    return pytest.mark.skipif(not path.exists(), reason=f"needs {path.relative_to(ROOT.parent)} beside the checkout")


def folder_of(variable: str) -> pytest.MarkDecorator:
    """Give a test the ``folder`` that an environment variable names; skip it where none is named."""
    named = os.environ.get(variable)
    reason = f"needs {variable}, the folder of a dataset (CONTRIBUTING.md)"
    return pytest.mark.parametrize(
        "folder", [pytest.param(Path(named or "."), marks=pytest.mark.skipif(named is None, reason=reason))], ids=[""]
    )


def import_path() -> dict[str, str]:
    """The environment of a Python that imports this package and the tests' helpers, wherever it runs."""
    return os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT / "src"), str(ROOT / "tests")))}
