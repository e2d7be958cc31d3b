"""``getagrip import masks``: masks into a clip, and nothing else changed."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.cli import main
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.io import arrays
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.folders import FullDisk, contents
from helpers.program_files import SIZE, encoded, labels, write_png


def test_command_adds_masks_to_a_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip, masks = small_clip()
    folder = write_clip(clip, None, tmp_path / "small")
    source = tmp_path / "sam2"
    source.mkdir()
    for n in range(len(clip)):
        write_png(source / f"{n + 50:05d}.png", masks.object[n] * 1 + masks.ignore[n] * 2, 8, 3, palette=True)
    command = ["import", "masks", str(source), "--object", "1", "--ignore", "2", "--clip", str(folder)]
    assert main(command) == 1
    assert not (folder / "masks").exists()
    assert main([*command, "--first", "50"]) == 0
    read = read_masks(read_clip(folder))
    np.testing.assert_array_equal(read.object, masks.object)
    np.testing.assert_array_equal(read.ignore, masks.ignore)
    assert "sam2" in read_clip(folder).provenance["masks"]
    assert main([*command, "--first", "50"]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_only_masks_are_overwritten(tmp_path: Path, run: Run) -> None:
    clip, masks = small_clip()
    folder = write_clip(clip, None, tmp_path / "small")
    arrays.write(tmp_path / "seen.npz", {"object": masks.object, "frames": np.arange(3)})
    (folder / "masks").mkdir()
    (folder / "masks" / "by hand.psd").write_text("three weeks' work")
    before = contents(tmp_path)
    status, _, err = run("import", "masks", tmp_path / "seen.npz", "--clip", folder, "--overwrite")
    assert status == 2
    assert f"{folder / 'masks'}: exists already without 'object' in it; it is not overwritten" in err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.slow
def test_masks_that_the_disk_has_no_room_for_leave_the_clip_as_it_was(
    tmp_path: Path, run: Run, full_disk: FullDisk, overwrite: bool
) -> None:
    folder = write_clip(replace(small_clip()[0], size=(320, 240)), None, tmp_path / "clips" / "small")
    noise = np.random.default_rng(0).random((3, 240, 320)) < 0.5
    arrays.write(tmp_path / "noise.npz", {"object": noise, "frames": np.arange(3)})
    command = ["import", "masks", tmp_path / "noise.npz", "--clip", folder, *["--overwrite"] * overwrite]
    if overwrite:
        assert run(*command)[0] == 0
    before = contents(tmp_path)
    with full_disk(4000):
        status, _, err = run(*command)
    assert status == 1
    assert str(folder / "masks" / "object" / "0000.png") in err
    assert err.count("\n") == 1
    assert contents(tmp_path) == before
    assert run(*command)[0] == 0
    np.testing.assert_array_equal(read_masks(read_clip(folder)).object, noise)


def counted_from_zero(folder: Path, kind: str, count: int) -> Path:
    """Masks of one thing with the numbers from 0 on."""
    seen = {n: (labels()[n % 2] == 1) for n in range(count)}
    names = [f"{n:05d}" for n in seen]
    if kind == "png":
        (folder / "png").mkdir()
        for name, mask in zip(names, seen.values(), strict=True):
            write_png(folder / "png" / f"{name}.png", mask * 1, 8, 0)
        return folder / "png"
    path = folder / {"npz": "m.npz", "pkl": "m.pkl", "coco": "m.json"}[kind]
    if kind == "npz":
        arrays.write(path, {"object": np.array([*seen.values()]), "frames": np.array(names)})
    elif kind == "pkl":
        path.write_bytes(pickle.dumps({n: {1: mask} for n, mask in seen.items()}))
    else:
        images = [{"id": n, "file_name": f"{name}.jpg", "width": 20, "height": 14} for n, name in enumerate(names)]
        of = [{"image_id": n, "category_id": 1, "segmentation": encoded(mask, False)} for n, mask in seen.items()]
        path.write_text(json.dumps({"images": images, "annotations": of}))
    return path


@pytest.mark.parametrize("kind", ["png", "npz", "pkl", "coco"])
@pytest.mark.parametrize("count", [3, 40])
def test_numbers_that_match_by_luck_are_refused(tmp_path: Path, run: Run, kind: str, count: int) -> None:
    """Counted from 0 they may be the clip's images, or the whole video's: there is a mask of every number, or none."""
    clip, _ = small_clip()
    folder = write_clip(replace(clip, frames=("0036", "0037", "0038"), size=SIZE), None, tmp_path / "small")
    source = counted_from_zero(tmp_path, kind, count)
    command = ("import", "masks", source, "--clip", folder)
    status, _, err = run(*command)
    assert status == 2
    assert "missing --first: the number of the mask of frame 0036" in err
    assert "--first 0 if the clip's images were segmented, --first 35 if the whole video was" in err
    assert not (folder / "masks").exists()
    status, _, err = run(*command, "--first", "0")
    assert (status, err) == (0, "")
    np.testing.assert_array_equal(read_masks(read_clip(folder)).object[1], labels()[1] == 1)


def test_numbers_of_frames_need_no_option(tmp_path: Path, run: Run) -> None:
    clip, _ = small_clip()
    folder = write_clip(replace(clip, frames=("0036", "0037", "0038"), size=SIZE), None, tmp_path / "small")
    source = counted_from_zero(tmp_path, "png", 40)
    (source / "00000.png").unlink()
    assert run("import", "masks", source, "--clip", folder)[0] == 0


def test_frames_without_a_mask_are_said(tmp_path: Path, run: Run) -> None:
    clip, masks = small_clip(5)
    folder = write_clip(clip, None, tmp_path / "small")
    arrays.write(tmp_path / "some.npz", {"object": masks.object[[0, 2]], "frames": np.array([0, 2])})
    status, _, err = run("import", "masks", tmp_path / "some.npz", "--clip", folder)
    assert status == 0
    assert "no mask of 3 of 5 frames (first: 0001)" in err
    assert read_masks(read_clip(folder)).known.tolist() == [True, False, True, False, False]
    arrays.write(tmp_path / "one.npz", {"object": masks.object[[3]], "frames": np.array([3])})
    status, _, err = run("import", "masks", tmp_path / "one.npz", "--clip", folder, "--overwrite")
    assert status == 3
    assert "visible in 1 frame" in err


def test_what_is_in_doubt_is_said_and_chosen(tmp_path: Path, run: Run) -> None:
    """Several things of one category, and two images of a frame."""
    clip, masks = small_clip()
    folder = write_clip(clip, None, tmp_path / "small")
    seen = (masks.object, masks.ignore)
    images = [
        {"id": f"{take}-{name}", "file_name": f"{take}/{name}.jpg", "width": 32, "height": 24}
        for take in ("take1", "take2")
        for name in clip.frames
    ]
    annotations = [
        {
            "image_id": f"take1-{clip.frames[n]}", "category_id": 1, "track_id": k,
            "segmentation": encoded(seen[k][n], True),
        }
        for n in range(len(clip))
        for k in range(2)
    ]  # fmt: skip
    (tmp_path / "c.json").write_text(json.dumps({"images": images, "annotations": annotations}))
    command = ("import", "masks", tmp_path / "c.json", "--clip", folder, "--object")
    status, _, err = run(*command, "1")
    assert status == 1
    assert "--images chooses: take1 or take2" in err
    status, _, err = run(*command, "1", "--images", "take1")
    assert status == 3
    assert "2 regions in 3 of 3 frames" in err
    assert run(*command, "1:0", "--images", "take1", "--overwrite")[0] == 0
    np.testing.assert_array_equal(read_masks(read_clip(folder)).object, masks.object)
    assert "images take1" in read_clip(folder).provenance["masks"]
