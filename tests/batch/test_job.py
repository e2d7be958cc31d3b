"""One clip from its folder to its result."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from getagrip.batch.claims import claim
from getagrip.batch.job import Job, reconstruct_one
from getagrip.clip import Clip, input_sha256, write_clip
from getagrip.finding import Finding
from getagrip.fitting.options import Options
from getagrip.io.files import to_json
from getagrip.result import Reconstruction, write_result
from helpers.command_line import Run
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
    assert reconstruct_one(replace(job, options=Options(method="static", seed=1))).state == "failed"


def test_two_runs_share_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    """What another run is at work on is left to it, and looked at last; nothing is done twice."""
    scene = egg_and_mug()
    for name in ("a", "b"):
        write_clip(replace(scene[0], name=name), scene[1], tmp_path / "clips" / name)
    out, made = tmp_path / "out", list[str]()

    def fit(clip: Clip, masks: object, options: Options, progress: object) -> Reconstruction:
        made.append(clip.name)
        if clip.name == "b":
            other.__exit__(None, None, None)  # the other run has ended meanwhile, without a result
        given = json.loads(to_json(asdict(options)))
        return replace(perfect(clip), clip=clip.name, options=given, method=options.method)

    monkeypatch.setattr("getagrip.fitting.reconstruct.reconstruct", fit)
    other = claim(out / "a", wait=True)
    assert other.__enter__()
    status, text, err = run("reconstruct", tmp_path / "clips", "--out", out)
    assert (status, err, made) == (0, "", ["b", "a"])
    assert "2 done, 0 already done, 0 failed" in text
    assert sorted(path.name for path in out.iterdir()) == ["a", "b"]  # no locks stay
    status, text, err = run("reconstruct", tmp_path / "clips", "--out", out, "--quiet")
    assert (status, text, err) == (0, "", "")
    assert made == ["b", "a"]
    assert run("reconstruct", tmp_path / "none", "--out", out, "--quiet")[2] != ""
