"""Reading clips: frames without the object, and for each fault a line that names the file and the key."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks, input_sha256, observed_frames, read_clip, read_masks, read_observed, write_clip
from getagrip.errors import InputError
from getagrip.io import files
from helpers.clip_faults import BROKEN, at, edit_json, edit_npz
from helpers.clips import small_clip

Refused = Callable[..., str]


def read_all(folder: Path) -> tuple[Clip, Masks]:
    clip = read_clip(folder)
    return clip, read_masks(clip)


def test_frames_without_a_visible_object_are_dropped_and_named() -> None:
    clip, masks = small_clip(4)
    masks.object[1] = False
    masks.ignore[2] = True
    short = observed_frames(clip, masks.observed)
    assert (short.frames, short.left_out) == (("0000", "0003"), ("0001", "0002"))
    assert len(short.hand.vertices) == 2


@given(hidden=st.lists(st.booleans(), min_size=5, max_size=5))
@pytest.mark.slow
def test_reading_some_frames_is_reading_all_and_choosing(five_frames: Path, hidden: list[bool]) -> None:
    clip = read_clip(five_frames)
    whole = read_masks(clip)
    np.testing.assert_array_equal(read_observed(clip), whole.observed)
    index = np.flatnonzero(hidden)
    if index.size:
        some = read_masks(clip.take(index))
        np.testing.assert_array_equal(some.object, whole.object[index])
        np.testing.assert_array_equal(some.ignore, whole.ignore[index])


@pytest.fixture(scope="module")
def five_frames(tmp_path_factory: Any) -> Path:
    """A clip whose frames differ, and of which the object is hidden in one."""
    clip, masks = small_clip(5)
    for n in range(5):
        masks.object[n] = np.roll(masks.object[n], n, axis=1)
    masks.ignore[3] = True
    return write_clip(clip, masks, tmp_path_factory.mktemp("five") / "small")


def test_one_frame_with_a_visible_object_is_too_few(refused: Refused) -> None:
    clip, masks = small_clip(3)
    masks.object[1:] = False
    refused(lambda: observed_frames(clip, masks.observed), "masks/object", "1 of 3 frames", "at least 2")


@pytest.mark.parametrize("case", BROKEN)
def test_each_fault_is_named_in_one_line(clip_folder: Path, refused: Refused, case: str) -> None:
    breaks, culprit, words = BROKEN[case]
    breaks(clip_folder)
    refused(lambda: read_all(clip_folder), culprit, *words)


@pytest.mark.parametrize("case", BROKEN)
def test_the_checksum_of_a_broken_clip_is_refused_or_reads_nothing_else(clip_folder: Path, case: str) -> None:
    """Whatever the clip says, only files inside it are opened."""
    BROKEN[case][0](clip_folder)
    opened: list[Path] = []
    read = files.read_bytes
    with pytest.MonkeyPatch.context() as patch, suppress(InputError):
        patch.setattr(files, "read_bytes", lambda path, *limit: opened.append(path) or read(path, *limit))
        input_sha256(clip_folder)
    assert all(path.resolve().is_relative_to(clip_folder.resolve()) for path in opened)


def test_the_checksum_names_what_is_missing(clip_folder: Path, refused: Refused) -> None:
    for file in ("masks/ignore/0001.png", "object.obj", "hand.npz", "clip.json"):
        (clip_folder / file).unlink()
        refused(lambda: input_sha256(clip_folder), file, "no such file")


def test_images_and_folders_of_them_that_lead_out_are_refused(clip_folder: Path, refused: Refused) -> None:
    clip, beside = read_clip(clip_folder), clip_folder.parent / "private.jpg"
    image, inner = clip_folder / "frames" / f"{clip.frames[0]}.jpg", clip_folder / "frames" / "other.jpg"
    image.parent.mkdir()
    for file in (beside, inner):
        file.write_bytes(b"an image")
    assert clip.image_file(0) is None
    image.symlink_to(inner)
    assert clip.image_file(0) == image
    image.unlink()
    image.symlink_to(beside)
    refused(lambda: clip.image_file(0), f"frames/{image.name} must be ", "got the path", "which leads out")
    inner.rename(inner.with_name(f"{clip.frames[1]}.jpg"))
    image.parent.rename(clip_folder.parent / "elsewhere")
    image.parent.symlink_to(clip_folder.parent / "elsewhere")
    refused(lambda: clip.image_file(1), "which leads out")


def test_hands_at_the_border_are_real(clip_folder: Path) -> None:
    """Half out of the image in every frame, and wholly out of it in some."""
    edit_npz("hand.npz", T_cam_hand=at((slice(None), 0, 3), 0.25))(clip_folder)
    edit_npz("hand.npz", T_cam_hand=at((1, 0, 3), 3.0))(clip_folder)
    read_clip(clip_folder)


def test_no_folder(tmp_path: Path, refused: Refused) -> None:
    refused(lambda: read_clip(tmp_path / "none"), "none", "no such folder")
    refused(lambda: read_clip(tmp_path / "none" / "clip.json"), "none", "no such folder")


def test_a_free_scale_needs_its_truth(clip_folder: Path, refused: Refused) -> None:
    edit_json(scale="free")(clip_folder)
    edit_npz("truth.npz", scale=None)(clip_folder)
    refused(lambda: read_clip(clip_folder), "truth.npz: missing scale")
    edit_json(scale="known")(clip_folder)
    truth = read_clip(clip_folder).truth
    assert truth is not None
    assert truth.scale == 1.0


# Damaged files.

FILES = ["clip.json", "hand.npz", "object.obj", "truth.npz", "masks/object/0001.png", "masks/ignore/0001.png"]


@pytest.fixture(scope="module")
def damaged_folder(tmp_path_factory: Any) -> Path:
    return write_clip(*small_clip(), tmp_path_factory.mktemp("damaged") / "small")


@pytest.mark.parametrize("file", FILES)
@given(data=st.data())
@pytest.mark.slow
def test_a_damaged_file_is_an_input_error_or_still_valid(damaged_folder: Path, file: str, data: st.DataObject) -> None:
    whole = (damaged_folder / file).read_bytes()
    broken = bytearray(whole)
    if data.draw(st.booleans(), "truncate"):
        broken = broken[: data.draw(st.integers(0, len(whole) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 4))):
            broken[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (damaged_folder / file).write_bytes(broken)
    try:
        with suppress(InputError):
            read_all(damaged_folder)
    finally:
        (damaged_folder / file).write_bytes(whole)


@pytest.mark.parametrize("file", ["hand.npz", "truth.npz", "masks/object/0001.png", "masks/ignore/0001.png"])
@given(data=st.data())
@pytest.mark.slow
def test_truncated_binary_files_are_never_valid(damaged_folder: Path, file: str, data: st.DataObject) -> None:
    whole = (damaged_folder / file).read_bytes()
    (damaged_folder / file).write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    try:
        with pytest.raises(InputError):
            read_all(damaged_folder)
    finally:
        (damaged_folder / file).write_bytes(whole)
