"""`getagrip segment --from-masks` and `reconstruct --find-grasps`: what they write, and what they say of bad clips."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, read_clip, write_clip
from getagrip.clip.timeline import read_segments
from getagrip.grasps import lists
from getagrip.io.images import write_image
from helpers.command_line import Run
from helpers.table_scene import HOLDING, LYING, from_table


def lying(folder: Path, name: str = "lying") -> Clip:
    """A clip whose object lies still before a camera that does, too, written into a folder."""
    clip, masks = from_table()
    clip = replace(clip.take(np.arange(12)), world=None, truth=None, name=name)
    write_clip(clip, masks.take(np.zeros(12, dtype=int)), folder / name)
    return clip


def test_all_segments_are_written_and_the_assumption_is_said(tmp_path: Path, run: Run) -> None:
    clip = lying(tmp_path / "clips")
    status, out, err = run("segment", "--from-masks", tmp_path / "clips", "--out", tmp_path / "out")
    assert status == 0
    assert "0 stable grasps in 0 of 1 clips" in out
    assert "lying: the camera is taken to stand still: a guess" in err
    written = json.loads((tmp_path / "out" / "segments.json").read_text())["lying"]
    (segment,) = read_segments(tmp_path, written["segments"], clip.frames, has_world=True)
    assert (segment.state, segment.first, segment.last, segment.side) == ("static", 0, 11, None)
    assert written["margins"][0] > 0.0
    with (tmp_path / "out" / "segments.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["sequence"], row["state"], row["start"], row["end"]) == ("lying", "static", "0", "11")
    assert not lists.read(tmp_path / "out" / "grasps.json", print).grasps


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
    status, out, _ = run("reconstruct", "--find-grasps", tmp_path / "clips", "--out", tmp_path / "out")
    assert status == 0
    assert "lying: no stable grasp" in out
    assert not (tmp_path / "out" / "lying--1").exists()


@pytest.mark.slow
def test_each_grasp_is_reconstructed_and_named(tmp_path: Path, run: Run) -> None:
    clip, masks = from_table()
    folder = write_clip(clip, masks, tmp_path / "clip")
    (folder / "frames").mkdir()
    for name in clip.frames:
        write_image(folder / "frames" / f"{name}.jpg", np.zeros((240, 320, 3), np.uint8))
    out = tmp_path / "out"
    call = ("reconstruct", "--find-grasps", folder, "--out", out, "--inits", 12, "--frames", 12)
    status, printed, _ = run(*call)
    assert status == 0
    cut = read_clip(out / "clips" / "from-table--1")
    assert f"from-table: stable grasps in frames {cut.frames[0]} to {cut.frames[-1]}" in printed
    assert abs(clip.frames.index(cut.frames[0]) - LYING) <= 3
    assert cut.frames[-1] == clip.frames[LYING + HOLDING - 1]
    assert "nats" in cut.provenance["found"]
    assert cut.image_file(0) is not None
    assert (out / "from-table--1" / "result.json").is_file()
    status, printed, _ = run(*call)
    assert status == 0
    assert "already done" in printed
