"""``import masks`` and imports into many clips: what changes in a clip, and several images of one frame."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.cli import main
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.hands import generic
from getagrip.io import arrays
from getagrip.io.images import write_image, write_mask
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


SETS = ("cam0", "cam1")
COUNT = 3


def files_of(place: Path, suffix: str, write: Callable[[Path, int], object]) -> Path:
    """A file of each frame and camera, and what other systems leave beside each."""
    place.mkdir()
    for n in range(COUNT):
        for name in SETS:
            write(place / f"{name}_{n:04d}{suffix}", n)
            (place / f"._{name}_{n:04d}{suffix}").write_bytes(b"\0\5\x16\7")
    return place


def masks(place: Path) -> Path:
    return files_of(place, ".png", lambda path, n: write_png(path, 1 * small_clip()[1].object[n], 8, 0))


def depth(place: Path) -> Path:
    return files_of(place, ".npy", lambda path, _: np.save(path, np.full((24, 32), 0.6, np.float32)))


def cameras(place: Path) -> Path:
    place.mkdir()
    matrix = np.eye(4).tolist()
    frames = [{"file_path": f"{s}/{n:04d}.jpg", "transform_matrix": matrix} for s in SETS for n in range(COUNT)]
    (place / "transforms.json").write_text(json.dumps({"frames": frames}))
    return place


IMPORTS = {
    "masks": (masks, ("import", "masks"), ()),
    "depth": (depth, ("import", "depth"), ("--from", "unidepth")),
    "cameras": (cameras, ("import", "cameras"), ()),
}


@pytest.mark.parametrize("kind", IMPORTS)
def test_two_of_a_frame_are_chosen_from(tmp_path: Path, run: Run, kind: str) -> None:
    make, command, options = IMPORTS[kind]
    folder = write_clip(small_clip()[0], None, tmp_path / "clip")
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    before = (folder / "clip.json").read_bytes()
    call = (*command, make(tmp_path / "theirs"), "--clip", folder, *options)
    status, _, err = run(*call)
    assert status == 1
    assert "a second " in err
    assert "of frame 0000" in err
    assert "--images chooses: cam0" in err
    assert (folder / "clip.json").read_bytes() == before
    status, _, err = run(*call, "--images", "cam1*" if kind != "cameras" else "cam1")
    assert status in (0, 3), err
    status, _, err = run(*call, "--images", "cam7", "--overwrite")
    assert status == 2
    assert "--images must be" in err


@pytest.mark.parametrize("names", [("rgb_{:06d}.png", "depth_{:06d}.png"), ("{:04d}.jpg", "{:04d}_thumb.jpg")])
def test_two_sets_of_a_folder_of_footage_are_chosen_from(tmp_path: Path, run: Run, names: tuple[str, str]) -> None:
    (tmp_path / "images").mkdir()
    for n in range(COUNT):
        for k, name in enumerate(names):
            write_image(tmp_path / "images" / name.format(n), np.full((24, 32, 3), 40 * k, np.uint8))
            (tmp_path / "images" / f"._{name.format(n)}").write_bytes(b"\0\5\x16\7")
    call = ["clip", "new", tmp_path / "images", "--interval", "1", "3", "--side", "right", "--mesh", "mug"]
    call += ["--focal", "40", "--out", tmp_path / "clip"]
    status, _, err = run(*call)
    patterns = [name.partition("{")[0] + "*" + name.partition("}")[2].rpartition(".")[0] for name in names]
    assert status == 1
    assert all(f"--images '{pattern}'" in err for pattern in patterns)
    status, _, err = run(*call, "--images", patterns[0])
    assert status == 3, err
    made = [path.name for path in sorted((tmp_path / "clip" / "frames").iterdir())]
    assert made == [Path(names[0].format(n)).stem + ".jpg" for n in range(COUNT)]


@pytest.mark.parametrize("kind", ["masks", "depth", "cameras"])
def test_first_chooses_among_rows_without_names(tmp_path: Path, run: Run, kind: str) -> None:
    """Arrays of a whole video: row N on is the clip's, and without --first it is asked for."""
    folder = write_clip(small_clip()[0], None, tmp_path / "clip")
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    seen = small_clip()[1].object
    if kind == "masks":
        np.save(tmp_path / "x.npy", np.concatenate([np.zeros_like(seen), seen, seen]))
        call = ["import", "masks", tmp_path / "x.npy"]
    elif kind == "depth":
        np.save(tmp_path / "x7.npy", np.concatenate([np.full((3, 24, 32), 9.0), np.full((6, 24, 32), 0.6)]))
        call = ["import", "depth", tmp_path / "x7.npy", "--from", "unidepth"]
    else:
        T = np.tile(np.eye(4), (9, 1, 1))
        T[:, 0, 3] = np.arange(9)
        np.savez(tmp_path / "x.npz", cam_c2w=T)
        call = ["import", "cameras", tmp_path / "x.npz"]
    call += ["--clip", folder]
    status, _, err = run(*call)
    assert status == 2
    assert "without names for 3 frames: missing --first N" in err
    assert run(*call, "--first", "8")[0] == 2
    status, _, err = run(*call, "--first", "3")
    assert status in (0, 3), err
    if kind == "cameras":
        camera = json.loads((folder / "clip.json").read_text())["camera"]
        assert np.array(camera["T_world_cam"])[:, 0, 3].tolist() == [3.0, 4.0, 5.0]
