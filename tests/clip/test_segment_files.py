"""Segments from a file into a clip: by frame, cut at its ends, before a camera that is said to stand still."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip import Segment, read_clip, write_clip
from helpers.clips import small_clip
from helpers.environment import Run

ROWS = [
    {"state": "static", "first": "1", "last": "3"},
    {"state": "grasp", "first": "4", "last": "90", "side": "right"},
    {"state": "free", "first": "91", "last": "99"},
]
SEGMENTS = (Segment("static", 1, 3), Segment("grasp", 4, 7, "right"))
"""What of them is in a clip of the frames 0000 to 0007."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    clip, _ = small_clip(8)
    return write_clip(replace(clip, truth=None), None, tmp_path / "clip")


def given(path: Path, rows: object = ROWS, **more: Any) -> Path:
    path.write_text(json.dumps({"some video": {"segments": rows, **more}}))
    return path


def test_frames_are_compared_as_numbers_and_segments_cut(folder: Path, tmp_path: Path, run: Run) -> None:
    file = given(tmp_path / "s.json", source="marked by ann", still_camera="as ann states")
    status, out, _ = run("import", "segments", file, "--clip", folder)
    assert (status, "2 segments: static, grasp" in out) == (0, True)
    clip = read_clip(folder)
    assert clip.segments == SEGMENTS
    assert clip.world is not None
    np.testing.assert_array_equal(clip.world.T_world_cam, np.tile(np.eye(4), (8, 1, 1)))
    assert clip.provenance == {
        "hands": "synthetic", "segments": "marked by ann",
        "camera_pose": "identity: the camera stands still, as ann states",
    }  # fmt: skip
    before = (folder / "clip.json").read_bytes()
    assert run("import", "segments", file, "--clip", folder)[0] == 2
    assert (folder / "clip.json").read_bytes() == before
    assert run("import", "segments", file, "--clip", folder, "--overwrite")[0] == 0
    assert (folder / "clip.json").read_bytes() == before


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (ROWS, "--still-camera"),
        ([ROWS[2]], "some of the frames 0000 to 0007"),
        ([ROWS[1], ROWS[1]], "segments[1].first"),
        ([{"state": "held", "first": "1", "last": "2"}], "segments[0].state"),
        ("none", "a list of objects"),
    ],
)
def test_what_does_not_fit_is_named_and_changes_nothing(
    folder: Path, tmp_path: Path, run: Run, rows: object, words: str
) -> None:
    before = (folder / "clip.json").read_bytes()
    status, _, err = run("import", "segments", given(tmp_path / "s.json", rows), "--clip", folder)
    assert (status, words in err) == (1, True), err
    assert (folder / "clip.json").read_bytes() == before
