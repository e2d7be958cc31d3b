"""VISOR's annotations: what is read from files of its schema, the masks they give, and what broken ones say."""

from __future__ import annotations

import json
import tracemalloc
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.errors import InputError
from getagrip.readers import streams
from getagrip.readers.datasets.epic import visor
from helpers.epic_files import box, dense, hand, sparse, thing, write, write_mapping

V = "P01_101"


def frames(path: Path) -> list[visor.VisorFrame]:
    return list(visor.read_frames(path))


def test_sparse_frames_are_read_as_they_stand(tmp_path: Path) -> None:
    glove = thing("g", "left glove", 303, box(0, 0, 9, 9), in_contact_object="b", on_which_hand=["left hand"])
    pair = thing("p", "rubber gloves", 60, box(0, 0, 9, 9), on_which_hand=["left hand", "right hand"])
    idle = thing("q", "oven glove", 60, box(0, 0, 9, 9), on_which_hand="inconclusive")
    bottle = thing("b", "olive oil bottle", 15, box(10, 20, 30, 40), [])
    path = write(
        tmp_path / f"{V}.json", [sparse(V, 140, bottle, hand("right", "b", box(1, 2, 3, 4)), glove, pair, idle)]
    )
    (frame,) = frames(path)
    assert (frame.number, frame.dense, frame.size, frame.ends) == (140, False, (1920, 1080), None)
    things = {a.id: a for a in frame.annotations}
    assert (things["b"].hands, things["b"].touches) == ((), None)
    assert len(things["b"].polygons) == 1  # empty ones occur, and are nothing
    np.testing.assert_array_equal(things["b"].polygons[0], box(10, 20, 30, 40))
    assert (things["right-hand"].hands, things["right-hand"].touches) == (("right",), "b")
    assert (things["g"].hands, things["g"].touches) == (("left",), "b")
    assert (things["p"].hands, things["p"].touches) == (("left", "right"), None)  # no such key
    assert things["q"].hands == ()  # a glove that nobody wears is an object


@pytest.mark.parametrize(
    ("given", "means"),
    [
        ("hand-not-in-contact", ""),
        ("glove-not-in-contact", ""),
        ("none-of-the-above", None),
        ("inconclusive", None),
        ("None", None),
        (None, None),
        ("abc", "abc"),
    ],
)
def test_every_word_for_contact_has_its_meaning(tmp_path: Path, given: str | None, means: str | None) -> None:
    path = write(tmp_path / f"{V}.json", [sparse(V, 1, hand("left", given, box(0, 0, 5, 5)))])
    assert frames(path)[0].annotations[0].touches == means


def test_dense_frames_are_in_their_own_pixels_and_know_their_ends(tmp_path: Path) -> None:
    path = write(
        tmp_path / f"{V}_interpolations.json", [dense(V, 143, (140, 150), thing("b", "cup", 13, box(0, 0, 9, 9)))]
    )
    (frame,) = frames(path)
    assert (frame.number, frame.dense, frame.size, frame.ends) == (143, True, (854, 480), (140, 150))


def test_frame_numbers_move_as_the_mapping_says(tmp_path: Path) -> None:
    path = write_mapping(tmp_path / "frame_mapping.json", V, {140: 138, 150: 147, 200: 197})
    assert visor.find_mapping(tmp_path) == path
    mapping = visor.read_mapping(path, V)

    def moved(number: int, ends: tuple[int, int] | None = None) -> int:
        return mapping.number(visor.VisorFrame(number, ends is not None, (), ends))

    assert moved(140) == 138
    assert [moved(n, (140, 150)) for n in (140, 141, 144, 147, 150)] == [138, 139, 142, 144, 147]  # the nearer end's
    assert moved(160) == 160  # nothing is known
    with pytest.raises(InputError, match="missing P02_01"):
        visor.read_mapping(path, "P02_01")
    assert visor.find_mapping(tmp_path / "nowhere") is None
    assert visor.read_mapping(None, V).number(visor.VisorFrame(7, False, ())) == 7


def test_a_mask_has_the_pixels_that_the_polygon_has() -> None:
    def drawn(*polygons: Any, size: tuple[int, int] = visor.DENSE_IMAGE_SIZE_PX) -> Any:
        arrays = tuple(np.array(polygon, np.float32) for polygon in polygons)
        return visor.draw_visor_mask(
            [visor.Annotation("", "cup", 13, arrays, (), None)], size, visor.DENSE_IMAGE_SIZE_PX
        )

    square = drawn(box(10, 20, 29, 39))
    assert square.sum() == square[20:40, 10:30].sum() == 400  # borders included
    assert drawn(box(10.9, 20.9, 29.9, 39.9)).sum() == 400  # cut down, as VISOR's own code does
    assert drawn(box(10, 20, 29, 39), box(15, 25, 24, 34)).sum() < 400  # even-odd: holes
    assert drawn(box(-500, -300, 800, 100)).sum() == 801 * 101  # what is outside is cut off
    large = drawn(box(480, 270, 1439, 809), size=visor.SPARSE_IMAGE_SIZE_PX)
    assert large.shape == (480, 854)
    assert abs(large.sum() - 0.25 * 480 * 854) < 900  # half as wide, half as high
    np.testing.assert_allclose(np.argwhere(large).mean(axis=0), [239.5, 426.5], atol=0.6)


def test_files_are_found_wherever_they_are_and_as_they_come(tmp_path: Path) -> None:
    path = write(tmp_path / "a" / f"{V}_interpolations.json", [dense(V, 143, (140, 150))])
    with zipfile.ZipFile(tmp_path / "P02_01_interpolations.zip", "w") as archive:
        archive.write(path, "P02_01_interpolations.json")
    (tmp_path / "P02_01.zip").write_bytes(b"images")
    write(tmp_path / "b" / f"{V}.json", [sparse(V, 1)])
    found = visor.find_visor_files(tmp_path)
    assert {video: sorted(p.name for p in paths) for video, paths in found.items()} == {
        V: [f"{V}.json", f"{V}_interpolations.json"],
        "P02_01": ["P02_01_interpolations.zip"],
    }
    assert frames(found["P02_01"][0]) == frames(path)
    with pytest.raises(InputError, match="VISOR's annotations"):
        visor.find_visor_files(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"segments": [box(0, 0, 1e9, 5)]}, "annotations[0].segments[0]"),
        ({"segments": [[[0, 1], [2]]]}, "annotations[0].segments[0]"),
        ({"segments": [[["0", "1"]]]}, "annotations[0].segments[0]"),
        ({"segments": [[[1e308, 1e308]]]}, "annotations[0].segments[0]"),
        ({"segments": [[[10**40, 0]]]}, "annotations[0].segments[0]"),
        ({"segments": "none"}, "annotations[0].segments"),
        ({"segments": [[[0, 0]] * 100_001]}, "annotations[0].segments"),
        ({"name": None}, "annotations[0].name"),
        ({"class_id": 1.5}, "annotations[0].class_id"),
    ],
)
@pytest.mark.slow
def test_what_is_wrong_is_named(tmp_path: Path, refused: Callable[..., str], change: dict[str, Any], key: str) -> None:
    bad = sparse(V, 7, thing("b", "cup", 13, box(0, 0, 5, 5)) | change)
    path = write(tmp_path / f"{V}.json", [sparse(V, 6), bad])
    refused(lambda: frames(path), str(path), f"video_annotations[1].{key}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the end of the file"),
        ("[]", "'{'"),
        ('{"info": 1}', "missing video_annotations"),
        ('{"video_annotations": 3}', "video_annotations"),
        ('{"video_annotations": [3]}', "video_annotations[0]"),
        ('{"video_annotations": [{"image": {}', "cut short"),
        ('{"video_annotations": [{"image": {"name": "x"}, "annotations": []}]}', "image.name"),
        ('{"video_annotations": [{"image": 1, "annotations": []}]}', "image"),
        ('{"video_annotations": [{"image": NaN}]}', "NaN"),
        ('{"video_annotations": [{}{}]}', "image"),
        ('{"a": ' + "[" * 100_000 + ', "video_annotations": []}', "a must be"),
        ('{"a": ' + "1" * 100_000 + "}", "a must be"),
    ],
)
def test_text_that_is_no_annotation_is_refused(
    tmp_path: Path, refused: Callable[..., str], text: str, words: str
) -> None:
    path = tmp_path / f"{V}.json"
    path.write_text(text)
    refused(lambda: frames(path), str(path), words)


@pytest.mark.slow
def test_a_file_is_read_in_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "JSON_CHUNK_BYTES", 2**12)
    one = json.dumps(sparse(V, 7, thing("b", "cup", 13, box(0, 0, 5, 5) * 50)))
    path = tmp_path / f"{V}.json"
    path.write_text('{"video_annotations": [' + ", ".join([one] * 100) + "]}")
    assert path.stat().st_size > 1.8e5
    tracemalloc.start()
    assert sum(1 for _ in visor.read_frames(path)) == 100
    assert tracemalloc.get_traced_memory()[1] < 1.2e5
    tracemalloc.stop()


@pytest.mark.slow
def test_an_endless_item_is_refused_before_memory_is_out(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams, "MAX_JSON_ITEM_CHARACTERS", 2**17)
    path = tmp_path / f"{V}.json"
    path.write_text('{"video_annotations": [{"a": [' + "[]," * 2_000_000)
    tracemalloc.start()
    refused(lambda: frames(path), "video_annotations[0]", "characters")
    assert tracemalloc.get_traced_memory()[1] < 100 * 2**17
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("limit", "words"),
    [("MAX_JSON_STREAM_BYTES", "more than 100000 bytes"), ("MAX_JSON_STREAM_VALUES", "100000 values")],
)
@pytest.mark.slow
def test_an_endless_file_is_refused(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch, limit: str, words: str
) -> None:
    monkeypatch.setattr(streams, limit, 100_000)
    path = tmp_path / "any.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("any.json", '{"wanted": [' + "{}," * 400_000 + "{}]}")
    assert path.stat().st_size < 10_000
    refused(lambda: list(streams.stream_items(path, "wanted")), words)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@settings(max_examples=10)
@given(
    before=st.dictionaries(st.text(), JSON, max_size=3), items=st.lists(st.dictionaries(st.text(), JSON), max_size=5)
)
@pytest.mark.slow
def test_items_are_those_of_the_list_wherever_it_stands(
    tmp_path_factory: pytest.TempPathFactory, before: dict[str, Any], items: list[dict[str, Any]]
) -> None:
    path = tmp_path_factory.mktemp("json") / "any.json"
    before.pop("wanted", None)
    path.write_text(json.dumps(before | {"wanted": items, "after": 1}, ensure_ascii=False), "utf-8")
    assert list(streams.stream_items(path, "wanted")) == items


@given(cut=st.integers(0, 10_000), swap=st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4))
def test_damaged_files_are_reported_or_read(
    tmp_path_factory: pytest.TempPathFactory, cut: int, swap: list[tuple[int, int]]
) -> None:
    path = tmp_path_factory.mktemp("cut") / f"{V}_interpolations.json"
    cup = thing("b", "cup", 13, box(10, 20, 30, 40))
    write(path, [dense(V, n, (140, 150), cup, hand("left", "b", box(1, 2, 9, 8))) for n in range(140, 146)])
    content = bytearray(path.read_bytes())
    for at, byte in swap:
        content[at % len(content)] = byte
    path.write_bytes(content[: max(len(content) - cut, 0)] if cut % 2 else content)
    with suppress(InputError):
        for frame in visor.read_frames(path):
            visor.draw_visor_mask(frame.annotations, frame.size, visor.DENSE_IMAGE_SIZE_PX)


@given(content=st.binary(max_size=300))
def test_any_bytes_are_refused_in_words(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    folder = tmp_path_factory.mktemp("bytes")
    for name in (f"{V}.json", f"{V}_interpolations.zip"):
        (folder / name).write_bytes(content)
        with pytest.raises(InputError):
            frames(folder / name)
