"""The summary of a batch, and what it prints of names."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from getagrip.batch.clips import _Tally, expected_right_message
from getagrip.batch.job import Outcome
from getagrip.batch.scheduling import KeepOptions
from getagrip.clip import input_sha256, write_clip
from getagrip.result import read_result, write_result
from getagrip.result.findings import ASSUMED_MESH, Probability
from helpers.environment import Run
from helpers.folders import results_in
from helpers.scenes import egg_and_mug, perfect

RED = "bad\x1b[31mRED\x07"
"""The name of a folder that colours what follows, and rings."""


def test_a_batch_is_summed_up_by_its_probabilities() -> None:
    assert (
        expected_right_message({"a": 0.95, "b": 0.98}) == "about 2 of 2 are right in the hand, by their probabilities"
    )
    assert expected_right_message({"a": 0.95}, "right in the camera").startswith(
        "about 1 of 1 are right in the camera, by"
    )
    text = expected_right_message({"a": 0.9, "b": 0.4, "c": 0.1, "d": 0.6})
    assert text.startswith("about 2 of 4 are right")
    assert text.endswith("worst first: c, b")


def test_a_batch_counts_apart_how_results_of_assumed_meshes_look(capsys: pytest.CaptureFixture[str]) -> None:
    tally = _Tally()
    for name, value, beyond in (("a", 0.9, ()), ("b", 0.12, (ASSUMED_MESH,)), ("c", 0.01, (ASSUMED_MESH,))):
        tally.add(Outcome(name, "done", "", probability_right=Probability(value, "", beyond)), KeepOptions())
    tally.print()
    assert capsys.readouterr().out.splitlines()[1:] == [
        "1 of 2 with an assumed mesh: probably looks right: b",
        "1 of 2 with an assumed mesh: probably looks wrong: c",
        "about 1 of 1 are right in the hand, by their probabilities",
    ]


def test_names_of_folders_move_no_cursor(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    """Nor do traces, which keep their lines."""
    (tmp_path / "clips" / RED).mkdir(parents=True)
    (tmp_path / "clips" / RED / "clip.json").write_text("{")
    for command in (("reconstruct", "--out", tmp_path / "out"), ("segment",)):
        status, out, err = run(*command, tmp_path / "clips", "--debug")
        assert status == 1
        assert "\x1b" not in out + err
        assert "\x07" not in out + err
        assert err.startswith(r"failed: bad\x1b[31mRED\x07: ")
        assert "\nTraceback (most recent call last):\n" in err


@pytest.mark.slow
def test_what_results_say_moves_no_cursor(tmp_path: Path, run: Run) -> None:
    clip, masks = egg_and_mug()
    written = write_clip(clip, masks, tmp_path / "clips" / clip.name)
    made_from = input_sha256(written)
    folders = [write_result(perfect(clip), tmp_path / name / RED, made_from, clip_folder=written) for name in "ab"]
    for folder, method in zip(folders, (RED, "static"), strict=True):
        fields = json.loads((folder / "result.json").read_text())
        (folder / "result.json").write_text(json.dumps(fields | {"method": method}))
    status, out, err = run("evaluate", *folders)
    assert (status, err) == (0, "")
    assert "\x1b" not in out
    assert r"\x1b[31mRED" in out
    status, out, err = run("export", folders[0].parent, "--to", "glb")
    assert (status, err) == (0, "")
    assert r"bad\x1b[31mRED" in out


@pytest.mark.slow
def test_two_workers_have_the_same_bits_as_one(can_and_box: Path, tmp_path: Path, run: Run) -> None:
    call = ("reconstruct", can_and_box, "--method", "static", "--inits", "4")
    found = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        assert run(*call, "--out", out, "--workers", workers)[0] == 0
        read = [read_result(folder) for folder in results_in(out)]
        found.append([(replace(result, seconds={}), record | {"seconds": {}}) for result, record in read])
    assert len(found[0]) == 2
    assert found[0] == found[1]
