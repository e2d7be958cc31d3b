"""`getagrip segment --from-masks` and `reconstruct --find-grasps`: what they write, and what they say of bad clips."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip import Clip, read_clip, write_clip
from getagrip.clip.timeline import read_segments
from getagrip.io.images import write_image
from getagrip.result import read_result
from getagrip.stable_grasps import grasp_lists
from getagrip.timelines.detect import detect_segments
from getagrip.timelines.detect.detect_segments import DetectedSegments
from helpers.environment import Run
from helpers.scenes import HOLDING, LYING, from_table


def lying(folder: Path, name: str = "lying") -> Clip:
    """A clip whose object lies still before a camera that does, too, written into a folder."""
    clip, masks = from_table()
    clip = replace(clip.take(np.arange(12)), world=None, truth=None, name=name)
    write_clip(clip, masks.take(np.zeros(12, dtype=int)), folder / name)
    return clip


@pytest.mark.slow
def test_all_segments_are_written_and_the_assumption_is_said(tmp_path: Path, run: Run) -> None:
    clip = lying(tmp_path / "clips")
    status, out, err = run("segment", "--from-masks", tmp_path / "clips", "--out", tmp_path / "out", "--write")
    assert status == 0
    assert "0 stable grasps in 0 of 1 clip" in out
    assert re.search(rf"lying +static +{clip.frames[0]} +{clip.frames[-1]} ", out)
    assert "margin: how much worse" in out
    assert "lying: the camera is taken to stand still: a guess" in err
    written = json.loads((tmp_path / "out" / "segments.json").read_text())["lying"]
    (segment,) = read_segments(tmp_path, written["segments"], clip.frames, has_world=True)
    assert (segment.state, segment.first, segment.last, segment.side) == ("static", 0, 11, None)
    assert written["margins"][0] > 0.0
    whole = read_clip(tmp_path / "clips" / "lying")
    assert whole.segments == (segment,)
    assert "guess" in whole.provenance["camera_pose"]
    status, _, err = run("segment", "--from-masks", tmp_path / "clips", "--write")
    assert (status, "--overwrite" in err) == (1, True)
    with (tmp_path / "out" / "segments.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["sequence"], row["state"], row["start"], row["end"]) == ("lying", "static", "0", "11")
    assert not grasp_lists.read_listed_grasps(tmp_path / "out" / "grasps.json", print).grasps


def test_a_bad_clip_is_named_and_the_rest_is_done(tmp_path: Path, run: Run) -> None:
    lying(tmp_path / "clips")
    bad = lying(tmp_path / "clips", "bad")
    (tmp_path / "clips" / "bad" / "masks" / "object" / f"{bad.frames[3]}.png").write_bytes(b"no image")
    status, out, err = run("segment", "--from-masks", tmp_path / "clips")
    assert status == 1
    assert "bad" in err
    assert "static" in out


def test_a_list_is_refused(tmp_path: Path, run: Run) -> None:
    lying(tmp_path)
    status, _, err = run("segment", "--from-masks", tmp_path / "lying", "--list", tmp_path / "grasps.json")
    assert status == 2
    assert "--list" in err


def test_a_clip_without_a_grasp_has_no_result_and_is_no_failure(tmp_path: Path, run: Run) -> None:
    lying(tmp_path / "clips")
    status, out, _ = run("reconstruct", "--cut-grasps", tmp_path / "clips", "--out", tmp_path / "out")
    assert status == 0
    assert "lying: no stable grasp" in out
    assert not (tmp_path / "out" / "lying--1").exists()


def test_timelines_have_one_method(tmp_path: Path, run: Run) -> None:
    status, _, err = run("reconstruct", "--find-grasps", "--method", "static", tmp_path, "--out", tmp_path / "out")
    assert (status, "--cut-grasps" in err) == (2, True)


@pytest.mark.slow
def test_grasps_and_the_whole_are_reconstructed_and_named(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: list[DetectedSegments] = []
    find = detect_segments.find_segments

    def find_once(*args: Any, **kwargs: Any) -> DetectedSegments:  # both commands ask for the same
        known.extend([] if known else [find(*args, **kwargs)])
        return known[0]

    monkeypatch.setattr(detect_segments, "find_segments", find_once)
    clip, masks = from_table()
    folder = write_clip(clip, masks, tmp_path / "clip")
    (folder / "frames").mkdir()
    for name in clip.frames:
        write_image(folder / "frames" / f"{name}.jpg", np.zeros((240, 320, 3), np.uint8))
    out = tmp_path / "out"
    search = ("--inits", 6, "--frames", 8)
    status, printed, _ = run("reconstruct", "--cut-grasps", folder, "--out", out, *search)
    assert status == 0
    cut = read_clip(out / "clips" / "from-table--1")
    assert f"from-table: stable grasps in frames {cut.frames[0]} to {cut.frames[-1]}" in printed
    assert abs(clip.frames.index(cut.frames[0]) - LYING) <= 3
    assert cut.frames[-1] == clip.frames[LYING + HOLDING - 1]
    assert "nats" in cut.provenance["found"]
    assert cut.image_file(0) is not None
    assert (out / "from-table--1" / "result.json").is_file()
    status, printed, _ = run("reconstruct", "--find-grasps", folder, "--out", out, *search)
    assert status == 0
    result, _ = read_result(out / "from-table")
    assert result.frames == clip.frames
    assert [one.state for one in result.segments] == ["static", "grasp"]
    assert result.segments[1].first == cut.frames[0]
    assert (out / "clips" / "from-table" / "frames" / f"{clip.frames[0]}.jpg").is_file()
