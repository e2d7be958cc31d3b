"""Masks from other people's files: what was drawn comes back, by label; what is wrong is named."""

from __future__ import annotations

import json
import pickle
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from getagrip.cli import main
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.clip.label_images import read_labels
from getagrip.clip.mask_request import MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.clip.segments import polygons, region, run_lengths
from getagrip.commands.import_masks import write_masks
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from helpers.clips import small_clip
from helpers.command_line import Run
from helpers.folders import FullDisk, contents
from helpers.mask_files import FRAMES, SIZE, coco, encoded, label_folder, labels, segments_of, write_png


@pytest.mark.parametrize(("depth", "kind"), [(1, 0), (2, 0), (4, 0), (8, 0), (16, 0), (1, 3), (2, 3), (4, 3), (8, 3)])
def test_labels_of_images(tmp_path: Path, depth: int, kind: int) -> None:
    """Grey values and palette indices of any depth are the labels, whatever colours the palette has."""
    given = labels()[0] % 2**depth
    write_png(tmp_path / "a.png", given, depth, kind, palette=kind == 3)
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png", SIZE), given)


def test_colours_are_labels(tmp_path: Path) -> None:
    colours = np.array([0x000000, 0xFF0000, 0x00FF00, 0x0102FF])
    value = colours[labels()[0]]
    cv2.imwrite(str(tmp_path / "a.png"), np.stack([value & 255, value >> 8 & 255, value >> 16], axis=-1))
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png", SIZE), value)


@pytest.mark.parametrize("source", ["png", "coco", "coco-plain", "npz"])
def test_every_source_gives_the_same_masks(tmp_path: Path, source: str) -> None:
    chosen, holding = (("1",), ("2", "3")), ("3",)
    if source == "png":
        path = label_folder(tmp_path / "labels")
    elif source == "npz":
        path = tmp_path / "m.npz"
        arrays.write(path, {"labels": labels()[::-1].astype(np.uint8), "frames": np.array([4, 3])})
    else:
        path, chosen = coco(tmp_path / "c.json", source == "coco"), (("cup",), ("hand", "3"))
    request = MaskRequest(FRAMES, SIZE, *chosen)
    read, hand_too = open_masks(path, request), open_masks(path, replace(request, ignore=chosen[1][:1], hand=holding))
    for n in range(2):
        seen, ignored, unknown = read(n)
        np.testing.assert_array_equal(seen, labels()[n] == 1)
        np.testing.assert_array_equal(ignored, labels()[n] >= 2)
        assert unknown is None
        np.testing.assert_array_equal(hand_too(n)[1], ignored)
        np.testing.assert_array_equal(hand_too(n)[2], labels()[n] == 3)


def test_several_labels_have_to_be_chosen_from(tmp_path: Path, refused: Callable[..., str]) -> None:
    folder = label_folder(tmp_path / "labels")
    refused(lambda: open_masks(folder, MaskRequest(FRAMES, SIZE))(0), "labels", "--object")
    refused(lambda: open_masks(coco(tmp_path / "c.json"), MaskRequest(FRAMES, SIZE))(0), "categories", "--object")
    seen, *_ = open_masks(folder, MaskRequest(FRAMES, SIZE, (), ("2", "3")))(0)
    np.testing.assert_array_equal(seen, labels()[0] == 1)
    with pytest.raises(UsageError, match="--object"):
        open_masks(folder, MaskRequest(FRAMES, SIZE, ("cup",)))


def test_labels_that_are_there_are_named_where_another_was_chosen(tmp_path: Path, refused: Callable[..., str]) -> None:
    request = MaskRequest(FRAMES, SIZE, ("7",))
    for source, names in [
        (label_folder(tmp_path / "labels"), "0, 1, 2, 3"),
        (coco(tmp_path / "c.json"), "cup, hand, "),
    ]:
        reader = open_masks(source, request)
        refused(lambda read=reader: write_masks(read, FRAMES, tmp_path / "out"), f"there are {names}")
        shutil.rmtree(tmp_path / "out")
    (tmp_path / "jpg").mkdir()
    cv2.imwrite(str(tmp_path / "jpg" / "000001.jpg"), np.zeros((4, 4), np.uint8))
    refused(lambda: open_masks(tmp_path / "jpg", request), "000001.jpg is no PNG")


def test_folders_of_a_thing_each_are_chosen_by_name(tmp_path: Path) -> None:
    """As SAM 2 writes them, one for each object."""
    folder = tmp_path / "things"
    for value, thing in enumerate(("table", "cup", "left-hand", "sleeve")):
        (folder / thing).mkdir(parents=True)
        for n, frame in enumerate(FRAMES):
            write_png(folder / thing / f"{frame}.png", 255 * (labels()[n] == value), 8, 0)
    seen, ignored, hand = open_masks(folder, MaskRequest(FRAMES, SIZE, ("cup",), ("sleeve",), ("left-hand",)))(1)
    np.testing.assert_array_equal(seen, labels()[1] == 1)
    np.testing.assert_array_equal(ignored, labels()[1] >= 2)
    np.testing.assert_array_equal(hand, labels()[1] == 2)
    for chosen, word in ((("mug",), "'mug'"), (("../things/cup",), "'../things/cup'"), ((), "'object'")):
        with pytest.raises(UsageError, match=f"--object: got {word}.*cup, left-hand"):
            open_masks(folder, MaskRequest(FRAMES, SIZE, chosen))
    (folder / "cup").rename(folder / "object")
    (folder / "left-hand").rename(folder / "hand")
    seen, ignored, hand = open_masks(folder, MaskRequest(FRAMES, SIZE))(0)
    np.testing.assert_array_equal(seen, labels()[0] == 1)
    np.testing.assert_array_equal(ignored, labels()[0] == 2)
    np.testing.assert_array_equal(hand, ignored)
    for thing in ("table", "hand", "sleeve"):
        shutil.rmtree(folder / thing)
    (folder / "object").rename(folder / "1")
    np.testing.assert_array_equal(open_masks(folder, MaskRequest(FRAMES, SIZE))(0)[0], labels()[0] == 1)


def test_missing_frames_are_named(tmp_path: Path, refused: Callable[..., str]) -> None:
    folder = label_folder(tmp_path / "labels")
    request = MaskRequest((*FRAMES, "000009"), SIZE, ("1",))
    refused(lambda: open_masks(folder, request), str(folder), "000009")
    refused(lambda: open_masks(coco(tmp_path / "c.json"), request), "images", "000009")
    (folder / "x_4.png").write_bytes((folder / "frame_4.png").read_bytes())
    refused(lambda: open_masks(folder, MaskRequest(FRAMES, SIZE)), "second mask")


def test_polygons_fill_the_pixels_whose_centres_they_hold() -> None:
    square = polygons(Path("c.json"), "s", [[3.0, 2.0, 9.0, 2.0, 9.0, 6.0, 3.0, 6.0]], SIZE)
    expected = np.zeros(SIZE[::-1], dtype=bool)
    expected[2:6, 3:9] = True
    inner = np.zeros_like(expected)
    inner[3:5, 4:8] = True
    assert square[inner].all()
    assert np.count_nonzero(square != expected) <= 2 * (6 + 4) + 4  # the border's own pixels, at most
    everything = polygons(Path("c.json"), "s", [[-20, -14, 40, -14, 40, 28, -20, 28]], SIZE)
    assert everything.all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.booleans())
def test_run_lengths_come_back(seed: int, share: float, compressed: bool) -> None:
    mask = np.random.default_rng(seed).random(SIZE[::-1]) < share
    np.testing.assert_array_equal(run_lengths(Path("c"), "s", encoded(mask, compressed), SIZE), mask)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.sampled_from(["size", "counts", "x"]), inner),
    max_leaves=20,
)


@settings(max_examples=200, deadline=None)
@given(JUNK | st.fixed_dictionaries({"size": st.just([14, 20]), "counts": JUNK | st.text("0123456789:;<=>?@PQRSTUVo")}))
@pytest.mark.slow
def test_any_segmentation_is_read_or_refused(value: Any) -> None:
    try:
        assert region(Path("c.json"), "annotations[0].segmentation", value, SIZE).shape == SIZE[::-1]
    except InputError as error:
        assert "annotations[0].segmentation" in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    "segmentation",
    [
        [[1, 1, 2, 2]],
        [[float("inf"), 1, 2, 2, 3, 3]],
        [[1e9, 1, 2, 2, 3, 3]],
        [["a", 1, 2, 2, 3, 3]],
        [[1, 1, 2, 2, 3, 3, 4]],
        {"size": [14, 21], "counts": [294]},
        {"size": [14, 20], "counts": [2**62, 2**62]},
        {"size": [14, 20], "counts": [-1, 281]},
        {"size": [14, 20], "counts": "o" * 100},
        {"size": [14, 20], "counts": "\u00ff"},
    ],
)
def test_impossible_segmentations(refused: Callable[..., str], segmentation: Any) -> None:
    refused(lambda: region(Path("c.json"), "annotations[7]", segmentation, SIZE), "c.json", "annotations[7]")


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
@pytest.mark.slow
def test_damaged_files_are_refused_or_read(tmp_path: Path, data: st.DataObject) -> None:
    """Truncated files and swapped bytes."""
    kind = data.draw(st.sampled_from(["png", "json", "npz"]))
    folder = tmp_path / "labels"
    if not folder.exists():
        label_folder(folder)
    path = {"png": folder / "frame_3.png", "json": tmp_path / "c.json", "npz": tmp_path / "m.npz"}[kind]
    if kind == "png":
        write_png(path, labels()[0], 8, 3, palette=True)
    elif kind == "json":
        coco(path)
    else:
        arrays.write(path, {"labels": labels().astype(np.uint8)})
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        a, b = (data.draw(st.integers(0, len(content) - 1)) for _ in range(2))
        content[a], content[b] = content[b], content[a]
    path.write_bytes(bytes(content))
    try:
        seen, ignored, _ = open_masks(folder if kind == "png" else path, MaskRequest(FRAMES, SIZE, ("1",), ("2",)))(0)
    except InputError as error:
        assert path.name in str(error)  # noqa: PT017
    else:
        assert seen.shape == ignored.shape == SIZE[::-1]


def test_huge_images_take_no_memory(tmp_path: Path, refused: Callable[..., str]) -> None:
    folder = tmp_path / "labels"
    folder.mkdir()
    for name in FRAMES:
        write_png(folder / f"{name}.png", np.zeros((1, 1)), 8, 0)
        content = bytearray((folder / f"{name}.png").read_bytes())
        content[16:24] = struct.pack(">II", 100_000, 100_000)
        content[29:33] = struct.pack(">I", zlib.crc32(bytes(content[12:29])))
        (folder / f"{name}.png").write_bytes(bytes(content))
    refused(lambda: open_masks(folder, MaskRequest(FRAMES, SIZE, ("1",)))(0), "size", "100000")
    bomb = tmp_path / "c.json"
    bomb.write_text('{"images":' + "[" * 200_000)
    refused(lambda: open_masks(bomb, MaskRequest(FRAMES, SIZE)), str(bomb))


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


@pytest.mark.parametrize("protocol", [2, 4, 5, "npy"])
def test_video_segments(tmp_path: Path, refused: Callable[..., str], protocol: Any) -> None:
    path = tmp_path / ("segments.npy" if protocol == "npy" else "segments.pkl")
    content = segments_of(2)
    del content[1][3]  # no object yet, or no more
    if protocol == "npy":
        np.save(path, content, allow_pickle=True)  # type: ignore[arg-type]
    else:
        path.write_bytes(pickle.dumps(content, protocol=protocol))
    request = MaskRequest(("000000", "000001"), SIZE, ("1",), ("2", "3"))
    read = open_masks(path, request)
    for n in range(2):
        seen, ignored, unknown = read(n)
        np.testing.assert_array_equal(seen, labels()[n] == 1)
        np.testing.assert_array_equal(ignored, np.isin(labels()[n], [2, 3] if n == 0 else [2]))
        assert unknown is None
        _, same, hand = open_masks(path, replace(request, ignore=("2",), hand=("3",)))(n)
        np.testing.assert_array_equal(same, ignored)
        np.testing.assert_array_equal(hand, (labels()[n] == 3) & (n == 0))
    for chosen, option in (((), "--object"), (("7",), "--object")):
        with pytest.raises(UsageError, match=f"{option}.*1, 2, 3"):
            open_masks(path, replace(request, object=chosen))
    for kind in ("ignore", "hand"):
        with pytest.raises(UsageError, match=f"--{kind}: got '7'"):
            open_masks(path, replace(request, **{kind: ("7",)}))  # type: ignore[arg-type]
    refused(lambda: open_masks(path, replace(request, size=(21, 14))), str(path), "0.1")
    refused(lambda: open_masks(path, replace(request, frames=("000001", "000002"))), "nothing of 1 of 2 frames")


@pytest.mark.parametrize(
    "content", [segments_of(1, float), {0: [1]}, {0: {1: "x"}}, {0: {1: np.zeros((20, 14), bool)}}]
)
def test_what_are_no_video_segments(tmp_path: Path, refused: Callable[..., str], content: Any) -> None:
    path = tmp_path / "segments.pkl"
    path.write_bytes(pickle.dumps(content))
    refused(lambda: open_masks(path, MaskRequest(("0",), SIZE)), str(path))


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
    assert "--first: got nothing, expected the number of the mask of frame 0036" in err
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
