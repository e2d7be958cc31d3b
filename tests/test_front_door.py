"""The root package: its names are there, light to load, and stay what they are whatever else is imported."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys

import pytest

import getagrip
from getagrip.moved import NEW_NAMES

FUNCTIONS = {name for name in getagrip.__all__ if name == name.lower()}
HEAVY = "{'numpy', 'numba', 'scipy', 'trimesh', 'cv2', 'matplotlib', 'igl'} & set(sys.modules)"


def fresh(code: str) -> str:
    """What some code prints in a process of its own."""
    done = subprocess.run([sys.executable, "-c", f"import sys\n{code}"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_root_has_what_it_lists() -> None:
    assert {"reconstruct", "evaluate", "read_clip", "synthesise", "write_report"} <= FUNCTIONS
    assert dir(getagrip) == getagrip.__all__ == sorted(getagrip.__all__)
    for name in getagrip.__all__:
        expected = inspect.isfunction if name in FUNCTIONS else inspect.isclass
        assert expected(getattr(getagrip, name))
    assert not hasattr(getagrip, "nonsense")
    with pytest.raises(AttributeError, match=r"no attribute 'reconstuct'; choose from reconstruct"):
        _ = getagrip.reconstuct
    module = "import getagrip\ntry: getagrip.export\nexcept AttributeError as error: print(error)"
    assert fresh(module).endswith("it is a module: import getagrip.export")
    assert getagrip.__version__.count(".") == 2


def test_importing_the_root_and_its_options_loads_nothing_heavy() -> None:
    assert fresh(f"import getagrip\ngetagrip.Options(seed=1), getagrip.InputError\nprint({HEAVY})") == "set()"


@pytest.mark.slow
def test_no_module_takes_the_place_of_a_function() -> None:
    for module in pkgutil.walk_packages(getagrip.__path__, "getagrip."):
        if module.name != "getagrip.__main__":
            importlib.import_module(module.name)
    assert [name for name in getagrip.__all__ if not callable(getattr(getagrip, name))] == []


def test_modules_are_found_under_their_former_names_for_one_release() -> None:
    for former, new in NEW_NAMES.items():
        name = next(one for one in vars(importlib.import_module(f"getagrip.{new}")) if not one.startswith("_"))
        with pytest.warns(DeprecationWarning, match=f"getagrip.{former} is now getagrip.{new}"):
            exec(f"from getagrip.{former} import {name}", {})
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("getagrip.evaluation.nonsense")
    with pytest.raises(ImportError):
        exec("from getagrip.grasps import stable_grasps", {})
