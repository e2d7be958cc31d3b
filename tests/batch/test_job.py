"""One clip from its folder to its result."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from getagrip.batch.job import Job, reconstruct_one, standing
from getagrip.clip import input_sha256, write_clip
from getagrip.finding import Finding
from getagrip.fitting.methods import METHODS, Method
from getagrip.fitting.options import Options
from getagrip.io.files import to_json
from getagrip.result import Reconstruction, write_result
from helpers.egg_and_mug import egg_and_mug, perfect

DOUBT = Finding("contact-gap", True, 240.0, 15.0, "nothing is held")


def test_a_result_that_another_run_made_meanwhile_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    job = Job("egg-and-mug", folder, tmp_path / "out", Options(method="static"), overwrite=False)
    options = json.loads(to_json(asdict(job.options)))
    found = replace(perfect(scene[0]), options=options, findings=(DOUBT,))

    def slow(*_: Any) -> Reconstruction:
        write_result(found, job.out, input_sha256(folder))  # the other run ends first
        return found

    monkeypatch.setattr("getagrip.fitting.reconstruct.reconstruct", slow)
    outcome = reconstruct_one(job)
    assert outcome.state == "kept"
    assert outcome.findings == (DOUBT,)
    other = replace(job, options=Options(method="static", seed=1))
    assert standing(other, input_sha256(folder)) == (None, "what was there is of another seed")


@pytest.mark.parametrize(
    ("options", "said"),
    [(Options(mesh="as-given"), "none is calibrated with mesh as-given"), (Options(method="static"), "for static")],
)
def test_why_there_is_no_probability_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: Options, said: str
) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    monkeypatch.setattr("getagrip.fitting.reconstruct.reconstruct", lambda *_: perfect(scene[0]))
    outcome = reconstruct_one(Job("egg-and-mug", folder, tmp_path / "out", options, overwrite=False))
    assert (outcome.state, f"{said}), " in outcome.message) == ("done", True)
    assert outcome.message.startswith("IOU ")
    assert ", no probability that it is right (none is calibrated " in outcome.message


def test_results_of_a_method_of_ones_own_are_kept_as_long_as_its_file_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    checksum, own = input_sha256(folder), tmp_path / "own_weights.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    own.write_text("def fit(problem, on_stage): return 1.0\n")
    monkeypatch.setitem(METHODS, "own", Method("Own", importlib.import_module("own_weights").fit))
    job = Job("egg-and-mug", folder, tmp_path / "out", Options(method="own"), overwrite=False)
    result = replace(perfect(scene[0]), method="own", options=json.loads(to_json(asdict(job.options))))
    monkeypatch.setattr("getagrip.fitting.reconstruct.reconstruct", lambda *_: result)
    assert reconstruct_one(job).state == "done"
    assert reconstruct_one(job).state == "kept"
    own.write_text("def fit(problem, on_stage): return 1e7\n")
    assert standing(job, checksum) == (None, "what was there is of other code")
    monkeypatch.delitem(sys.modules, "own_weights")
    monkeypatch.setitem(sys.modules, "own_weights", ModuleType("own_weights"))  # as a prompt is, it is in no file
    assert standing(job, checksum) == (None, "the method's code is in no file, so that it may have changed")
