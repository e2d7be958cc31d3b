"""Masks from files of other programs: every source gives the same, what is wrong is named."""

from __future__ import annotations

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

from getagrip.cli.import_files import write_reader_masks
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.readers.masks.mask_request import MaskRequest, read_label_image
from getagrip.readers.masks.mask_sources import open_masks
from helpers.program_files import FRAMES, SIZE, coco, label_folder, labels, segments_of, write_png


@pytest.mark.parametrize(("depth", "kind"), [(1, 0), (2, 0), (4, 0), (8, 0), (16, 0), (1, 3), (2, 3), (4, 3), (8, 3)])
def test_labels_of_images(tmp_path: Path, depth: int, kind: int) -> None:
    """Grey values and palette indices of any depth are the labels, whatever colours the palette has."""
    given = labels()[0] % 2**depth
    write_png(tmp_path / "a.png", given, depth, kind, palette=kind == 3)
    np.testing.assert_array_equal(read_label_image(tmp_path / "a.png", SIZE), given)


def test_colours_are_labels(tmp_path: Path) -> None:
    colours = np.array([0x000000, 0xFF0000, 0x00FF00, 0x0102FF])
    value = colours[labels()[0]]
    cv2.imwrite(str(tmp_path / "a.png"), np.stack([value & 255, value >> 8 & 255, value >> 16], axis=-1))
    np.testing.assert_array_equal(read_label_image(tmp_path / "a.png", SIZE), value)


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
        refused(lambda read=reader: write_reader_masks(read, FRAMES, tmp_path / "out"), f"there are {names}")
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
        with pytest.raises(UsageError, match=f"{word}; choose from .*cup, left-hand"):
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


def test_frames_may_have_no_mask_but_not_two(tmp_path: Path, refused: Callable[..., str]) -> None:
    folder = label_folder(tmp_path / "labels")
    arrays.write(tmp_path / "m.npz", {"labels": labels().astype(np.uint8), "frames": np.array([3, 4])})
    (tmp_path / "s.pkl").write_bytes(pickle.dumps({3: {1: labels()[0] == 1}, 4: {1: labels()[1] == 1}}))
    sparse, elsewhere = ("000002", *FRAMES, "000009"), ("000007", "000009")
    for source, label in (
        (folder, "1"),
        (coco(tmp_path / "c.json"), "cup"),
        (tmp_path / "m.npz", "1"),
        (tmp_path / "s.pkl", "1"),
    ):
        reader = open_masks(source, MaskRequest(sparse, SIZE, (label,)))
        assert [n for n in range(4) if reader(n) is not None] == [1, 2]
        read = reader(1)
        assert read is not None
        np.testing.assert_array_equal(read.object, labels()[0] == 1)
        refused(lambda at=source: open_masks(at, MaskRequest(elsewhere, SIZE, ("1",))), "no mask of any of 2 frames")
    (folder / "x_4.png").write_bytes((folder / "frame_4.png").read_bytes())
    refused(lambda: open_masks(folder, MaskRequest(FRAMES, SIZE)), "second mask")


@pytest.mark.parametrize("key", ["object", "labels"])
def test_an_array_of_one_number_is_refused(tmp_path: Path, refused: Callable[..., str], key: str) -> None:
    arrays.write(tmp_path / "m.npz", {key: np.array(1)})
    refused(lambda: open_masks(tmp_path / "m.npz", MaskRequest(FRAMES, SIZE)), key, "of shape ()", "(n, H, W)")


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
        with pytest.raises(UsageError, match=f"unknown --{kind} '7'"):
            open_masks(path, replace(request, **{kind: ("7",)}))  # type: ignore[arg-type]
    refused(lambda: open_masks(path, replace(request, size=(21, 14))), str(path), "0.1")


@pytest.mark.parametrize(
    "content",
    [
        segments_of(1, complex),
        {0: {1: np.full((14, 20), 2.5)}},
        {0: [1]},
        {0: {1: "x"}},
        {0: {1: np.zeros((20, 14), bool)}},
    ],
)
def test_what_are_no_video_segments(tmp_path: Path, refused: Callable[..., str], content: Any) -> None:
    path = tmp_path / "segments.pkl"
    path.write_bytes(pickle.dumps(content))
    refused(lambda: open_masks(path, MaskRequest(("0",), SIZE)), str(path))
