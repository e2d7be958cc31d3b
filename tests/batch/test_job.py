"""One clip from its folder to its result."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from getagrip.batch.job import Job, existing_outcome, failed_outcome, reconstruct_one
from getagrip.clip import input_sha256, write_clip
from getagrip.fitting.options import Options
from getagrip.io.files import to_json
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import ASSUMED_MESH, Finding, Probability
from helpers.scenes import egg_and_mug, perfect

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

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", slow)
    outcome = reconstruct_one(job)
    assert outcome.state == "kept"
    assert outcome.findings == (DOUBT,)
    other = replace(job, options=Options(method="static", seed=1))
    assert existing_outcome(other, input_sha256(folder)) == (None, "the earlier result is of another seed")


@pytest.mark.parametrize(
    ("options", "said"),
    [(Options(mesh="as-given"), "none is calibrated with mesh as-given"), (Options(method="static"), "for static")],
)
def test_why_there_is_no_probability_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: Options, said: str
) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_: perfect(scene[0]))
    outcome = reconstruct_one(Job("egg-and-mug", folder, tmp_path / "out", options, overwrite=False))
    assert (outcome.state, f"{said}), " in outcome.message) == ("done", True)
    assert outcome.message.startswith("IOU ")
    assert ", no probability that it is right (none is calibrated " in outcome.message


def test_how_a_result_of_an_assumed_mesh_looks_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    found = replace(perfect(scene[0]), probability_right=Probability(0.12, "", (ASSUMED_MESH,)), ambiguous=True)
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_: found)
    outcome = reconstruct_one(Job("egg-and-mug", folder, tmp_path / "out", Options(), overwrite=False))
    assert " 12 % (extrapolated: assumed mesh) in the hand, probably looks right, ambiguous, " in outcome.message


OWN = """
import numpy as np

def fit(poses):
    return poses.t

def library():
    return np.zeros(2) @ np.zeros(3)

def deep():
    return library()
"""


@pytest.mark.parametrize(
    ("name", "line"), [("fit", "mine.py:5: AttributeError: 'int' object"), ("deep", "mine.py:8: ValueError: matmul")]
)
def test_an_error_of_own_code_says_where(tmp_path: Path, name: str, line: str) -> None:
    source = tmp_path / "mine.py"
    source.write_text(OWN)
    there: dict[str, Any] = {}
    exec(compile(OWN, str(source), "exec"), there)
    with pytest.raises(Exception) as caught:  # noqa: PT011
        there[name](*[1] * (name == "fit"))
    error = caught.value.with_traceback(caught.value.__traceback__.tb_next)  # without the line of this test
    assert failed_outcome("cup", error).message.startswith(line)
    assert failed_outcome("cup", KeyError("a")).message == "unexpected KeyError: 'a'"
