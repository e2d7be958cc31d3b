"""``getagrip study``: what it writes and prints, and what it refuses."""

from __future__ import annotations

import csv
import json
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.batch import executor
from getagrip.bench.figures.study_figure import GRASP_BAND_COLOUR
from getagrip.clip import write_clip
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.report.pictures.panels import AXIS_COLOUR, RESULT_COLOUR
from getagrip.stable_grasps.study import NORMALISED_TIMES, STUDY_MEASURES, study
from helpers.pages import pixels_of, read_picture
from helpers.scenes import turning

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.slow
def test_all_is_written_and_printed(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_clip(turning("a"), None, tmp_path / "clips" / "a")
    write_clip(replace(turning("b", "left"), category="[bold]x"), None, tmp_path / "clips" / "b")
    away = turning("away")
    assert away.truth is not None
    far = replace(away.truth, T_cam_obj=away.truth.T_cam_obj @ se3.rigid(t=np.array([0.2, 0.0, 0.0])))
    write_clip(replace(away, truth=far), None, tmp_path / "clips" / "away")
    out, file = tmp_path / "out", tmp_path / "study.json"
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--workers", 1, "--out", out, "--json", file)
    status, printed, err = run("study", tmp_path / "clips", *options)
    assert (status, err) == (0, "")
    assert "2 stable grasps in 2 of 3 clips" in printed
    assert "[bold]x" in printed
    with (out / "grasps.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["sequence"], row["side"], row["start"], row["end"]) for row in rows] == [
        ("a", "right", "0", "29"),
        ("b", "left", "0", "29"),
    ]
    content = json.loads(file.read_text())
    assert [one["sequence"] for one in content["grasps"]] == ["a", "b"]
    assert content["cut"]["contact"] == pytest.approx(0.005)
    means = {
        (row["object"], row["where"], row["measure"]): row["mean"]
        for row in content["summary"]
        if row["measure"].endswith("rotation")
    }
    assert means["All", "inside", "one_dof_rotation"] < 1e-6 < means["All", "inside", "static_rotation"]
    with (out / "curves.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == len(STUDY_MEASURES) * len(NORMALISED_TIMES)
    with (out / "summary.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 3 * 2 * len(STUDY_MEASURES)
    picture = read_picture(out / "study.png")
    for third in np.array_split(picture, 3, axis=1):
        for half in np.array_split(third, 2):
            assert pixels_of(half, GRASP_BAND_COLOUR) > 1000  # six panels, the time of the grasp in blue
    assert pixels_of(picture, RESULT_COLOUR) > 200  # static
    assert pixels_of(picture, AXIS_COLOUR) > 200  # 1-DoF
    monkeypatch.setattr(executor, "run_in_processes", crossing)
    again = run("study", tmp_path / "clips", *options, "--workers", 2)
    assert again == (status, printed, err)  # a clip without grasps is none that failed


def crossing(work: Callable, jobs: list, _: int) -> Iterator[tuple[object, object]]:
    """What crosses to other processes and back is pickled; that these do the work is tested with ``segment``."""
    for job in jobs:
        there = pickle.loads(pickle.dumps((work, job)))
        yield job, pickle.loads(pickle.dumps(there[0](there[1])))


@pytest.mark.slow
def test_one_bad_clip_stops_no_other(run: Run, tmp_path: Path) -> None:
    write_clip(turning("good"), None, tmp_path / "good")
    write_clip(replace(turning("blind"), truth=None), None, tmp_path / "blind")
    paths = (tmp_path / "blind", tmp_path / "gone", tmp_path / "good")
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--out", tmp_path / "out")
    status, printed, err = run("study", *paths, *options)
    assert status == 1
    assert "1 stable grasp in 1 of 1 clip" in printed
    assert "gone: no such folder" in err
    assert "truth.npz: no such file" in err
    with pytest.raises(InputError, match=r"truth\.npz"):
        study(replace(turning(), truth=None))


def test_wrong_calls_exit_with_2(run: Run, tmp_path: Path) -> None:
    write_clip(turning(), None, tmp_path / "a")
    for wrong in ((), ("a", "--tau", "1"), ("a", "--contact-mm", "-1"), ("a", "--workers", "0")):
        paths = [tmp_path / word if word == "a" else word for word in wrong]
        assert run("study", *paths, "--out", tmp_path / "out")[0] == 2
    assert not (tmp_path / "out").exists()
