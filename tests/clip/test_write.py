"""Clips: what is written is read, and nothing is lost or left by halves while it is written."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks, World, input_sha256, read_clip, read_masks, read_name, write_clip
from getagrip.clip.write import write_hand
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.geometry.warp import Warp
from getagrip.io import files
from getagrip.io.images import write_image, write_mask
from helpers.clip_faults import edit_json, edit_npz, edit_png
from helpers.clips import small_clip
from helpers.folders import FullDisk, contents

Refused = Callable[..., str]


def read_all(folder: Path) -> tuple[Clip, Masks]:
    clip = read_clip(folder)
    return clip, read_masks(clip)


@given(frames=st.integers(1, 4), seed=st.integers(0, 99), side=st.sampled_from(["left", "right"]), steady=st.booleans())
@pytest.mark.slow
def test_what_is_written_is_read(tmp_path_factory: Any, frames: int, seed: int, side: str, steady: bool) -> None:
    clip, masks = small_clip(frames, seed)
    K = clip.K if steady else clip.K * np.linspace(1.0, 1.1, frames)[:, None, None] ** [[1, 1, 1], [1, 1, 1], [0, 0, 0]]
    clip = replace(clip, side=side, K=K)
    back, masks_back = read_all(write_clip(clip, masks, tmp_path_factory.mktemp("round") / "trip"))
    for name in ("name", "category", "side", "fps", "frames", "size", "scale", "provenance"):
        assert getattr(back, name) == getattr(clip, name)
    np.testing.assert_array_equal(back.K, clip.K)
    np.testing.assert_array_equal(masks_back.object, masks.object)
    np.testing.assert_array_equal(masks_back.ignore, masks.ignore)
    assert masks_back.hand is None
    for name in ("vertices", "faces", "T_cam_hand", "joints"):
        np.testing.assert_array_equal(getattr(back.hand, name), getattr(clip.hand, name))
    assert list(back.hand.regions) == list(clip.hand.regions)
    assert back.truth is not None
    np.testing.assert_array_equal(back.truth.T_cam_hand, clip.hand.T_cam_hand)
    assert back.mesh.diameter == pytest.approx(clip.mesh.diameter, abs=1e-7)
    assert back.mesh.volume == pytest.approx(clip.mesh.volume, rel=1e-5)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("up", [None, np.array([0.0, 1.0, 0.0])])
def test_camera_poses_and_times_are_kept(tmp_path: Path, moves: bool, up: np.ndarray | None) -> None:
    clip, _ = small_clip(3)
    T = se3.rigid(se3.exp_so3(np.array([[0.1, 0.2, n * moves] for n in range(3)])), np.array([[1.0, 2.0, 3.0]] * 3))
    clip = replace(clip, times=np.array([1.5, 1.6, 2.0]), world=World(T, up))
    folder = write_clip(clip, None, tmp_path / "clip")
    assert np.ndim(json.loads((folder / "clip.json").read_text())["camera"]["T_world_cam"]) == (3 if moves else 2)
    back = read_clip(folder)
    assert (back.times is not None, back.world) == (True, clip.world)
    np.testing.assert_array_equal(back.time, clip.times)
    some = back.take(np.array([0, 2]))
    assert some.world is not None
    np.testing.assert_array_equal(some.time, [1.5, 2.0])
    np.testing.assert_array_equal(some.world.T_world_cam, T[[0, 2]])


@pytest.mark.parametrize("points", [0, 2])
def test_a_marked_handle_is_kept_with_its_mesh(tmp_path: Path, points: int) -> None:
    clip, _ = small_clip()
    marked = replace(clip, handle=clip.mesh.vertices[:points])
    back = read_clip(write_clip(marked, None, tmp_path / "clip"))
    np.testing.assert_allclose(back.handle, marked.handle, atol=1e-12)
    np.testing.assert_array_equal(marked.resized(2.0).handle, marked.resized(2.0).mesh.vertices[:points])
    warp = Warp.by(np.zeros(3), 0.1, 0.01 * np.arange(27.0).reshape(9, 3))
    np.testing.assert_allclose(marked.warped(warp).handle, marked.warped(warp).mesh.vertices[:points], atol=1e-12)
    assert clip.resized(2.0).handle is clip.warped(warp).handle is None


def test_clips_of_version_1_are_read_as_before(clip_folder: Path) -> None:
    edit_json(version=1)(clip_folder)
    clip = read_clip(clip_folder)
    assert (clip.times, clip.world) == (None, None)
    np.testing.assert_allclose(clip.time, np.arange(3) / 30.0)
    np.testing.assert_allclose(clip.take(np.array([2])).time, 2 / 30.0)
    named = replace(clip, frames=("0007", "0010", "0011"))  # numbers say which frames were left out
    np.testing.assert_allclose(named.time, np.array([0, 3, 4]) / 30.0)
    for frames in (("b", "a", "c"), ("7", "6", "8")):
        np.testing.assert_allclose(replace(clip, frames=frames).time, np.arange(3) / 30.0)


def test_the_true_hand_is_kept_where_it_differs(tmp_path: Path) -> None:
    clip, _ = small_clip()
    assert clip.truth is not None
    other = replace(clip.truth, T_cam_hand=clip.hand.T_cam_hand[::-1].copy(), hand_vertices=1.1 * clip.hand.vertices)
    back = read_clip(write_clip(replace(clip, truth=other), None, tmp_path / "clip")).truth
    assert back is not None
    np.testing.assert_array_equal(back.T_cam_hand, other.T_cam_hand)
    np.testing.assert_array_equal(back.hand_vertices, other.hand_vertices)


def test_the_same_clip_gives_the_same_bytes(tmp_path: Path) -> None:
    clip, masks = small_clip()
    a, b = (write_clip(clip, masks, tmp_path / name) for name in "ab")
    assert input_sha256(a) == input_sha256(b)
    for file in a.rglob("*"):
        assert file.is_dir() or file.read_bytes() == (b / file.relative_to(a)).read_bytes()


def test_the_checksum_sees_inputs_and_nothing_else(clip_folder: Path) -> None:
    before = input_sha256(clip_folder)
    (clip_folder / "truth.npz").unlink()
    (clip_folder / "notes.txt").write_text("mine")
    assert input_sha256(clip_folder) == before
    edit_png(clip_folder / "masks/object/0001.png", np.invert)
    assert input_sha256(clip_folder) != before


def test_a_clip_is_named_by_its_folder_or_its_json(clip_folder: Path) -> None:
    assert read_name(clip_folder) == read_clip(clip_folder / "clip.json").name == "small"


def test_masks_are_needed_by_read_masks_only(clip_folder: Path, refused: Refused) -> None:
    shutil.rmtree(clip_folder / "masks")
    clip = read_clip(clip_folder)
    refused(lambda: read_masks(clip), "masks/object", "no mask of any frame")


def test_ignore_masks_and_truth_may_be_absent(clip_folder: Path) -> None:
    shutil.rmtree(clip_folder / "masks" / "ignore")
    (clip_folder / "truth.npz").unlink()
    clip, masks = read_all(clip_folder)
    assert clip.truth is None
    assert not masks.ignore.any()


def test_masks_of_the_holding_hand_alone_are_kept(tmp_path: Path) -> None:
    clip, masks = small_clip()
    hand = np.roll(masks.ignore, 1, axis=1) & masks.ignore
    folder = write_clip(clip, Masks(masks.object, masks.ignore, hand), tmp_path / "alone")
    known, without = read_masks(read_clip(folder)), input_sha256(folder)
    assert known.hand is not None
    np.testing.assert_array_equal(known.hand, hand)
    assert known.take(np.array([2, 0])).hand is not None
    shutil.rmtree(folder / "masks" / "hand")
    assert read_masks(read_clip(folder)).hand is None
    assert input_sha256(folder) != without


def test_arrays_beyond_the_format_are_ignored(clip_folder: Path) -> None:
    edit_npz("hand.npz", extra=np.array([None, "object"], dtype=object), weights=np.zeros(3))(clip_folder)
    assert set(read_clip(clip_folder).hand.regions) == {"thumb", "index", "middle", "ring", "pinky", "palm_edge"}


def test_frames_without_a_hand_are_left_out_until_they_have_one(tmp_path: Path, refused: Refused) -> None:
    """A ``hand.npz`` names the frames that it is of; with all of them it is the whole clip's again."""
    whole, masks = small_clip(4)
    K = whole.K * np.linspace(1.0, 1.1, 4)[:, None, None] ** [[1], [1], [0]]
    whole = replace(whole, truth=None, K=K, times=np.array([0.0, 0.1, 0.3, 0.4]), world=World(whole.hand.T_cam_hand))
    folder = write_clip(whole, masks, tmp_path / "clip")
    rows = np.array([0, 2])
    some, path = whole.take(rows), folder / "hand.npz"
    checksum = input_sha256(folder)
    write_hand(some.hand, path, {"frames": np.array(some.frames)})
    assert input_sha256(folder) != checksum
    clip, masks_back = read_all(folder)
    assert clip.frames == some.frames
    np.testing.assert_array_equal(clip.K, some.K)
    np.testing.assert_array_equal(clip.time, some.time)
    assert clip.world == some.world
    np.testing.assert_array_equal(clip.hand.vertices, some.hand.vertices)
    np.testing.assert_array_equal(masks_back.object, masks.object[rows])
    for names in (["0002", "0000"], ["0000", "0009"], ["0000", "0000"], []):
        write_hand(some.hand, path, {"frames": np.array(names, dtype=np.str_)})
        refused(lambda: read_clip(folder), str(path), "frames")
    write_hand(whole.hand, path, {"frames": np.array([7, 8, 9, 10])})  # numbers of the footage, as in a hand file
    assert read_clip(folder).frames == whole.frames


def test_images_are_written_as_given(tmp_path: Path) -> None:
    clip, masks = small_clip(2)
    red = np.zeros((24, 32, 3), np.uint8)
    red[..., 0] = 255
    folder = write_clip(clip, masks, tmp_path / "clip", [red, red])
    blue_green_red = cv2.imread(str(folder / "frames" / "0001.jpg"))[12, 16]
    assert blue_green_red[2] > 240
    assert blue_green_red[0] < 15


def test_existing_folders_are_left_alone(clip_folder: Path) -> None:
    with pytest.raises(UsageError, match="exists already"):
        write_clip(*small_clip(), clip_folder)
    read_all(clip_folder)


def test_only_clips_are_replaced_by_clips(tmp_path: Path) -> None:
    clip, masks = small_clip()
    write_clip(*small_clip(frames=2), tmp_path / "clip")
    write_clip(clip, masks, tmp_path / "clip", replace=True)
    assert len(read_all(tmp_path / "clip")[0]) == len(clip)
    (tmp_path / "clips").mkdir()
    (tmp_path / "clip").rename(tmp_path / "clips" / "clip")
    (tmp_path / "letter.txt").write_text("dear")
    before = contents(tmp_path)
    for target in (tmp_path / "clips", tmp_path / "letter.txt"):
        with pytest.raises(UsageError, match=f"{target}: exists already without 'clip.json' in it"):
            write_clip(clip, masks, target, replace=True)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_clip_is_not_lost_while_it_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    folder = write_clip(*small_clip(frames=2), tmp_path / "clip")
    before, rename = contents(tmp_path), os.rename

    def interrupted(source: Path, target: Path) -> None:
        if source.parent.name == "new":
            raise error
        rename(source, target)

    monkeypatch.setattr(os, "rename", interrupted)
    with pytest.raises(error):
        write_clip(*small_clip(), folder, replace=True)
    assert contents(tmp_path) == before


def test_nothing_half_written_is_left(tmp_path: Path) -> None:
    clip, masks = small_clip()
    with pytest.raises(ValueError, match="zip"):
        write_clip(clip, masks, tmp_path / "clip", images=[np.zeros((24, 32, 3), np.uint8)])  # one for three frames
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [100, 1_000, 4_000, 9_000])
@pytest.mark.parametrize("what", ["masks", "images"])
def test_clips_that_the_disk_has_no_room_for_are_not_written(
    tmp_path: Path, full_disk: FullDisk, what: str, size: int
) -> None:
    """Whichever file is the first that does not fit."""
    noise = np.random.default_rng(0).integers(0, 2, (3, 240, 320, 3), np.uint8)
    masks = Masks(noise[..., 0] > 0, noise[..., 1] > 0) if what == "masks" else None
    clip, images = replace(small_clip()[0], size=(320, 240)), [*255 * noise] if what == "images" else None
    sizes = {name: len(content) for name, content in contents(write_clip(clip, masks, tmp_path / "a", images)).items()}
    with full_disk(size), pytest.raises(OSError, match="too large") as caught:
        write_clip(clip, masks, tmp_path / "b", images)
    assert sizes[str(Path(caught.value.filename).relative_to(tmp_path / "b"))] > size
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a system without /dev/full")
@pytest.mark.parametrize("name", ["mask.png", "image.jpg", "clip.json", "hand.npz", "object.obj"])
def test_a_full_disk_is_an_error_that_names_the_file(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")  # as Python says it: without a name

    (clip, masks), path = small_clip(), tmp_path / name
    path.write_bytes(b"old")
    monkeypatch.setattr(Path, "write_bytes", full)
    write: dict[str, Callable[[], object]] = {
        ".png": lambda: write_mask(path, masks.object[0]),
        ".jpg": lambda: write_image(path, np.zeros((24, 32, 3), np.uint8)),
        ".json": lambda: files.write_json(path, {}),
        ".npz": lambda: write_hand(clip.hand, path),
        ".obj": lambda: write_mesh(clip.mesh, path),
    }
    with pytest.raises(OSError, match="No space left") as caught:
        write[path.suffix]()
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
