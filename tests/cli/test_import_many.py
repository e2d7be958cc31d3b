"""Hands and masks of many clips by their names: what is there is imported, what fails ends nothing, again is quick."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.hands import generic
from getagrip.io import arrays
from getagrip.io.images import write_mask
from helpers.clips import small_clip
from helpers.environment import Run

AHEAD = np.array([0.0, 0.0, 0.5])
NAMES = ("one", "two", "three")


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Three clips without hands and masks, and the estimates of two; those of the third are damaged."""
    clip, masks = small_clip()
    joints = generic.load(clip.side).with_shape().with_pose().joints + AHEAD
    for name in NAMES:
        folder = write_clip(clip, masks, tmp_path / "clips" / name)
        fields = json.loads((folder / "clip.json").read_text())
        (folder / "clip.json").write_text(json.dumps(fields | {"name": name}))
        (folder / "hand.npz").unlink()
        (folder / "truth.npz").unlink(missing_ok=True)
        shutil.rmtree(folder / "masks")
        demo = tmp_path / "demos" / name
        demo.mkdir(parents=True)
        arrays.write(demo / "soma.npz", {"joints": np.tile(with_metacarpals(joints), (len(clip), 1, 1))})
        for frame, mask in zip(clip.frames, masks.object, strict=True):
            (tmp_path / "masks" / name / "object").mkdir(parents=True, exist_ok=True)
            write_mask(tmp_path / "masks" / name / "object" / f"{frame}.png", mask)
    (tmp_path / "demos" / "two" / "soma.npz").write_bytes(b"PK nothing")
    return tmp_path / "clips"


def with_metacarpals(joints: np.ndarray) -> np.ndarray:
    parts = [joints[:5]]
    for first in range(5, 21, 4):
        parts += [0.5 * (joints[:1] + joints[first : first + 1]), joints[first : first + 4]]
    return np.concatenate(parts)


@pytest.mark.slow
def test_hands_and_masks_of_a_folder_of_clips(tmp_path: Path, clips: Path, run: Run) -> None:
    call = ("import", "hands", str(tmp_path / "demos"), "--clips", str(clips))
    status, out, err = run(*call)
    assert status == 1
    assert "2 clips imported, 0 done already, 1 failed" in out
    assert "soma.npz" in err
    kept = (clips / "one" / "hand.npz").read_bytes()
    shutil.copy(tmp_path / "demos" / "one" / "soma.npz", tmp_path / "demos" / "two" / "soma.npz")
    status, out, _ = run(*call)
    assert "1 clip imported, 2 done already, 0 failed" in out
    assert status in (0, 3)
    assert (clips / "one" / "hand.npz").read_bytes() == kept
    shutil.rmtree(tmp_path / "masks" / "three")
    call = ("import", "masks", str(tmp_path / "masks"), "--clips", str(clips))
    status, out, err = run(*call)
    assert status == 1
    assert "2 clips imported, 0 done already, 1 failed" in out
    assert "three" in err
    clip = read_clip(clips / "two")
    assert clip.hand.joints is not None
    assert read_masks(clip).object.any()


def test_calls_that_do_not_fit(tmp_path: Path, clips: Path, run: Run) -> None:
    status, _, err = run("import", "hands", str(tmp_path / "none"), "--clips", str(clips))
    assert (status, "no such folder" in err) == (1, True)
    status, _, err = run("import", "hands", "x", "--clips", str(clips), "--clip", str(clips / "one"))
    assert (status, "--clip cannot be used with --clips" in err) == (2, True)
    status, _, err = run("import", "masks", "x")
    assert (status, "missing --clip or --clips" in err) == (2, True)


def test_warnings_stand_beside_the_clip_and_several_sources_are_an_error(tmp_path: Path, clips: Path, run: Run) -> None:
    frame = next((tmp_path / "masks" / "one" / "object").iterdir())
    frame.unlink()
    (tmp_path / "masks" / "two.zip").write_bytes(b"")
    status, out, err = run("import", "masks", str(tmp_path / "masks"), "--clips", str(clips))
    assert (status, "2 clips imported, 0 done already, 1 failed" in out) == (1, True)
    assert any(line.startswith("one: warning: ") and "no mask of 1 of" in line for line in err.splitlines())
    assert "two and two.zip must be one file or folder named like the clip (got several)" in err
    (tmp_path / "masks" / "two.zip").unlink()
    status, out, _ = run("import", "masks", str(tmp_path / "masks"), "--clips", str(clips), "--overwrite")
    assert (status, "3 clips imported" in out) == (3, True)
