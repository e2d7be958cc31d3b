"""The example of another package, installed, through the command line; and a broken one beside it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import read_clip
from getagrip.geometry import se3
from helpers.environment import ROOT, import_path, write_package

pytestmark = [pytest.mark.slow, pytest.mark.long]

Call = Callable[..., str]
BUILD = "import sys, hatchling.build; print(hatchling.build.build_wheel(sys.argv[1]))"
LOADED = """
import sys
from getagrip.cli import main
try: main(sys.argv[1:])
except SystemExit: pass
sys.exit(", ".join(name for name in sys.modules if name.startswith("getagrip_upright")) or 0)
"""
TORN = {
    "methods": "torn = nowhere:METHOD\nstatic = getagrip_upright.method:UPRIGHT",
    "datasets": "torn = torn:DATASET", "trackers": "torn = torn:TRACKER", "exports": "torn = torn:EXPORT",
    "metrics": "torn = torn:METRIC", "input_checks": "torn = torn:CHECK", "result_checks": "torn = torn:CHECK",
    "modalities": "torn = torn:MODALITY",
}  # fmt: skip
"""A package of which nothing is right."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of installed packages with the example in it: no index is asked, and pip need not be there."""
    folder = tmp_path_factory.mktemp("packages")
    command = [sys.executable, "-c", BUILD, str(folder)]
    subprocess.run(command, cwd=ROOT / "examples" / "plugin", check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "installed")
    return folder / "installed"


def ran(code: list[str], installed: Path, folder: Path, *args: object) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join((import_path()["PYTHONPATH"], str(installed)))
    environment = os.environ | {"PYTHONPATH": path, "COLUMNS": "300"}
    command = [sys.executable, *code, *map(str, args)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def there(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Call]:
    """A folder with the example's clips and their results, and how to call the command line in it."""
    folder = tmp_path_factory.mktemp("there")

    def call(*args: object) -> str:
        done = ran(["-m", "getagrip"], installed, folder, *args)
        assert done.returncode in (0, 3), done.stderr
        return done.stdout + done.stderr

    call("import", "plates", "--count", "2", "--frames", "6", "--out", "clips", "--workers", "2")
    bench = ("bench", "clips", "--methods", "upright", "static", "--out", "bench", "--inits", "2", "--workers", "2")
    assert "plate-1: 2 done" in call(*bench)
    assert "plate-1: 0 done, 2 already done" in call(*bench)
    return folder, call


def test_method_term_dataset_metric_and_checks_are_found_also_by_workers(there: tuple[Path, Call]) -> None:
    folder, call = there
    record = json.loads((folder / "bench" / "results" / "upright" / "plate-0" / "result.json").read_text())
    assert record["method"] == "upright"
    assert record["energy"]["upright"] > 0.0
    assert {"short", "tilted"} <= {*record["checks"]}
    assert "short" in [finding["check"] for finding in record["findings"]]
    assert record["metrics"]["tilt_deg"] >= 0.0
    assert "tilt, °" in (folder / "bench" / "methods.md").read_text()
    assert "tilt: error of" in " ".join(call("evaluate", "bench/results/upright").split())


def test_a_modality_is_read_from_the_clip_and_counts(there: tuple[Path, Call]) -> None:
    folder, call = there
    clip = shutil.copytree(folder / "clips" / "plate-1", folder / "seen" / "plate-1")
    frames = np.array(read_clip(clip).frames)[1:]
    np.savez(clip / "axis.npz", frames=frames, direction=np.tile([0.0, -1.0, 0.0], (len(frames), 1)))
    call("reconstruct", "seen", "--out", "with-axis", "--inits", "2", "--workers", "1")
    record = json.loads((folder / "with-axis" / "plate-1" / "result.json").read_text())
    assert record["energy"]["axis"] > 0.0
    assert "(modalities axis " in record["software"]["plugins"]
    assert record["probability_right"] is None


def test_a_term_on_the_hand_moves_it(there: tuple[Path, Call]) -> None:
    folder, call = there
    clip = read_clip(shutil.copytree(folder / "clips" / "plate-0", folder / "wrist" / "plate-0"))
    assert clip.hand.joints is not None
    joints = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    beside = joints + np.array([0.01, 0.0, 0.03])
    rows = [",".join([name, *map(str, one.ravel())]) for name, one in zip(clip.frames, beside, strict=True)]
    (folder / "beside.csv").write_text("\n".join(rows))
    call("import", "hands", "--from", "csv", "beside.csv", "--clip", "wrist/plate-0", "--overwrite")
    np.savez(folder / "wrist" / "plate-0" / "wrist.npz", frames=clip.frames, position=joints[:, 0])
    call("reconstruct", "wrist", "--out", "with-wrist", "--inits", "2", "--workers", "1")
    record = json.loads((folder / "with-wrist" / "plate-0" / "result.json").read_text())
    before, after = record["hand_energy"]["wrist"]
    assert after < 0.2 * before


def test_a_result_says_which_packages_made_it(there: tuple[Path, Call]) -> None:
    folder, _ = there
    by = {}
    for method in ("upright", "static"):
        record = json.loads((folder / "bench" / "results" / method / "plate-0" / "result.json").read_text())
        by[method] = record["software"]["plugins"]
        assert "getagrip-upright 0.1 (metrics tilt_deg " in record["software"]["evaluation"]
    assert by["upright"].startswith("getagrip-upright 0.1 (methods upright ")
    assert by["static"].startswith("getagrip-upright 0.1 (modalities axis ")


def test_the_export_is_found(there: tuple[Path, Call]) -> None:
    folder, call = there
    call("export", "bench/results/static/plate-0", "--to", "tilt", "--out", "exported")
    lines = (folder / "exported" / "plate-0" / "tilt.txt").read_text().splitlines()
    assert len(lines) == 6
    assert "of other packages: tilt" in re.sub(r"[\s│]+", " ", call("export", "--help"))


def test_the_tracker_is_found(there: tuple[Path, Call]) -> None:
    folder, call = there
    clip = read_clip(shutil.copytree(folder / "clips" / "plate-0", folder / "tracked"))
    assert clip.hand.joints is not None
    joints = 1e3 * se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    rows = [",".join([name, *map(str, one.ravel())]) for name, one in zip(clip.frames, joints, strict=True)]
    (folder / "joints.csv").write_text("\n".join(rows))
    units = ("--csv-metres", "0.001")
    call("import", "hands", "--from", "csv", *units, "joints.csv", "--clip", "tracked", "--overwrite")
    again = read_clip(folder / "tracked")
    assert again.provenance["hands"].text.startswith("joints from a CSV file")
    assert np.abs(again.hand.T_cam_hand - clip.hand.T_cam_hand).max() < 0.5


@pytest.mark.parametrize("words", ["--help", "reconstruct --help", "bench synthetic --help", "import dexycb --help"])
def test_help_of_something_else_loads_nothing_of_it(installed: Path, tmp_path: Path, words: str) -> None:
    done = ran(["-c", LOADED], installed, tmp_path, *words.split())
    assert (done.returncode, done.stderr) == (0, "")
    assert ("upright" in done.stdout) == (words in ("reconstruct --help", "bench synthetic --help"))


def test_a_broken_package_is_named_and_stops_nothing_else(
    installed: Path, there: tuple[Path, Call], tmp_path: Path
) -> None:
    folder, _ = there
    write_package(tmp_path, "torn", "9.9", "raise RuntimeError('torn')", **TORN)
    both = Path(f"{installed}{os.pathsep}{tmp_path}")

    def call(words: str) -> tuple[int, str, str]:
        done = ran(["-m", "getagrip"], both, folder, *words.split())
        return done.returncode, done.stdout, done.stderr

    status, out, err = call("evaluate bench/results/upright/plate-0")
    assert (status, "plate-0" in out) == (0, True)
    assert "getagrip.metrics 'torn' of torn 9.9 (torn:METRIC) cannot be loaded: RuntimeError: torn" in err
    status, _, err = call("bench clips --methods torn upright --inits 2 --workers 1 --out torn")
    assert status != 0
    assert "getagrip.methods 'torn' of torn 9.9 (nowhere:METHOD) cannot be loaded: ModuleNotFoundError" in err
    assert "'static' of torn 9.9 (getagrip_upright.method:UPRIGHT) is left out: getagrip has 'static' itself" in err
    status, _, err = call("export bench/results/upright/plate-0 --to torn")
    assert (status, "getagrip.exports 'torn' of torn 9.9" in err) == (2, True)
    status, out, err = call("import --help")
    assert (status, "plates" in out) == (0, True)
    assert "getagrip.datasets 'torn' of torn 9.9" in err
    assert call("import torn --help")[0] == 2
    status, out, err = call("import hands --help")
    assert (status, "csv" in out, "getagrip.trackers 'torn' of torn 9.9" in err) == (0, True, True)
