"""Arrays of untrusted files: numbers that cannot be right, and files that are small and unpack to much."""

from __future__ import annotations

import json
import signal
import sqlite3
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from fuzz.containers import glb, glb_parts
from getagrip.clip import read_clip
from getagrip.clip.read import read_header
from getagrip.errors import InputError, UsageError
from getagrip.fitting.solver.initial_poses import read_learnt
from getagrip.geometry.mesh_files import obj, read_mesh
from getagrip.geometry.mesh_files.obj import parse_obj
from getagrip.hands import mano
from getagrip.io import arrays, files, processes
from getagrip.io.arrays import convert_to_input_errors
from getagrip.readers import footage, streams
from getagrip.readers.datasets.epic import epic_images
from getagrip.readers.datasets.realsense import read_yaml
from getagrip.readers.masks import mask_regions
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.readers.trackers import records
from getagrip.studio.store.mark_store import Store


class Stop(BaseException):
    """As trio's, or pytest's own."""


@pytest.fixture(autouse=True)
def _as_in_the_program() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    processes.raise_on_interrupt()
    yield
    signal.signal(signal.SIGINT, before)


def test_where_interrupts_are_not_known_apart_they_stay() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt), convert_to_input_errors(Path("a.txt")):
        raise KeyboardInterrupt


def leaves(error: BaseException) -> Callable[[], object]:
    def raising() -> None:
        raise error

    return raising


@pytest.mark.parametrize(
    ("work", "says"),
    [
        (lambda: np.zeros(4) / np.linalg.norm(np.zeros(4)), "invalid value encountered"),
        (lambda: np.array([1e300]) ** 2, "overflow"),
        (lambda: np.ones(1, complex).astype(float), "imaginary"),
        (lambda: float(10**400), "OverflowError"),
        (lambda: {}["a"], "KeyError"),
        (lambda: np.mean(np.zeros(0)), "empty"),
        (leaves(RecursionError("deep")), "RecursionError: deep"),
        (leaves(Stop("stopped")), "Stop: stopped"),
        (leaves(SystemExit(3)), "SystemExit: 3"),
        (leaves(KeyboardInterrupt()), "KeyboardInterrupt"),  # nobody has pressed a key
    ],
)
def test_what_goes_wrong_names_the_file(work: Callable[[], object], says: str) -> None:
    before = list(warnings.filters)
    with (
        pytest.raises(InputError, match=r"^a\.txt must be as its program writes it") as caught,
        convert_to_input_errors(Path("a.txt")),
    ):
        work()
    assert says in str(caught.value)
    assert list(warnings.filters) == before


@pytest.mark.parametrize("error", [UsageError("a"), InputError("b.txt", "", "c", "d"), FileNotFoundError("e")])
def test_what_says_enough_stays_as_it_is(error: Exception) -> None:
    with pytest.raises(type(error)) as caught, convert_to_input_errors(Path("a.txt")):
        raise error
    assert caught.value is error


def test_an_interrupt_stays_one() -> None:
    with pytest.raises(KeyboardInterrupt), convert_to_input_errors(Path("a.txt")):
        signal.raise_signal(signal.SIGINT)


PATH = Path("a.file")
LONG = 4_000_000


@contextmanager
def memory(megabytes: int) -> Iterator[None]:
    """Within it, so much more memory can be had and no more."""
    resource = pytest.importorskip("resource")
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("what the process has is not known")
    before = resource.getrlimit(resource.RLIMIT_AS)
    now = int(statm.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + megabytes * 2**20, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_one_long_text_among_numbers_takes_no_memory_for_all(refused: Callable[..., str]) -> None:
    values = ["x" * LONG, *[""] * 200]
    with memory(200):
        refused(lambda: records.record_numbers(PATH, {"joints": values}, "joints", (-1, 3)), "joints")
        refused(lambda: mask_regions.fill_polygons(PATH, "p", [values], (10, 10)), "corners")
        assert arrays.from_lists(values) is None


@pytest.mark.slow
def test_a_list_of_one_array_many_times_is_counted_in_full(refused: Callable[..., str]) -> None:
    values = [np.zeros(100_000)] * 5000
    with memory(200):
        refused(lambda: records.record_numbers(PATH, {"joints": values}, "joints", (-1, 3)), "joints")


@pytest.mark.parametrize(
    ("method", "why"), [(zipfile.ZIP_DEFLATED, "Bad CRC-32"), (zipfile.ZIP_BZIP2, "than by deflate")]
)
def test_a_member_that_unpacks_to_more_than_it_says_takes_no_memory(tmp_path: Path, method: int, why: str) -> None:
    size = 40 * 2**20
    for path in (tmp_path / "a.npz", tmp_path / "a.zip"):
        with zipfile.ZipFile(path, "w", method) as archive:
            archive.writestr("a.npy" if path.suffix == ".npz" else "a.json", bytes(size))
        path.write_bytes(path.read_bytes().replace(size.to_bytes(4, "little"), (100).to_bytes(4, "little")))
    with memory(25):
        with pytest.raises(InputError, match=why):
            arrays.read(tmp_path / "a.npz", lambda _: True)
        with pytest.raises(InputError, match="than by deflate" if why == "than by deflate" else "must be"):
            streams.read_json_member(tmp_path / "a.zip", "a")


def test_an_archive_of_too_many_members_is_not_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MAX_ARCHIVE_MEMBERS", 2)
    arrays.write(tmp_path / "a.npz", {name: np.zeros(1) for name in "ab"})
    assert set(arrays.read(tmp_path / "a.npz", lambda _: True)) == {"a", "b"}
    arrays.write(tmp_path / "a.npz", {name: np.zeros(1) for name in "abc"})
    with pytest.raises(InputError, match="more than 2 members"):
        arrays.read(tmp_path / "a.npz", lambda _: False)


def test_lists_become_the_arrays_that_numpy_makes_of_them() -> None:
    for good in ([1, 2], [[1.5, 2], [3, 4]], [], 3.0, [np.zeros(2), [1, 2]], [True, False]):
        found = arrays.from_lists(good)
        assert found is not None
        assert np.array_equal(found, np.array(good))
        assert found.dtype == np.array(good).dtype
    for bad in (["1", 2], [[1], [1, 2]], None, "text", [None], {}, [[[[[[[[[[1]]]]]]]]]]):
        assert arrays.from_lists(bad) is None


def test_texts_in_place_of_a_camera_are_refused(clip_folder: Path, refused: Callable[..., str]) -> None:
    path = clip_folder / "clip.json"
    content = json.loads(path.read_text())
    content["camera"]["K"] = ["x" * LONG, *[""] * 200]
    path.write_text(json.dumps(content))
    with memory(200):
        refused(lambda: read_header(clip_folder), "camera")


def test_narrow_numbers_are_refused_by_their_size_as_floats(refused: Callable[..., str]) -> None:
    given = {"vertices": np.broadcast_to(np.float16(0), (30_000, 778, 3))}
    with memory(200):
        refused(lambda: arrays.floats(PATH, given, "vertices", (-1, -1, 3)), "70020000 numbers")


def test_narrow_vertex_ids_are_refused_by_their_size_as_whole_numbers(refused: Callable[..., str]) -> None:
    given = {"region_thumb": np.broadcast_to(np.uint8(0), (70_000_000,))}
    with memory(200):
        refused(lambda: arrays.indices(PATH, given, "region_thumb", 778, (-1,)), "70000000 numbers")


def test_many_names_and_numbers_of_frames_become_no_lists(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "hand.npz"
    monkeypatch.setattr(arrays, "MAX_ARRAY_NAMES", 3)
    for frames in (np.arange(3), np.array(["a", "b", "c"])):
        arrays.write(path, {"frames": frames})
        assert arrays.array_from_names(arrays.read(path, lambda _: True)["frames"]) is not None
    assert arrays.frame_numbers(path, {"frames": np.arange(3)}) == (0, 1, 2)
    refused(
        lambda: arrays.frame_numbers(path, {"frames": np.arange(4)}),
        "frames must be ",
        "got int64 of shape (4,)",
        "1 to 3",
    )
    refused(lambda: arrays.frame_numbers(path, {"frames": np.zeros(2, int)}), "frames must be ", "got a frame twice")
    assert arrays.array_from_names(np.arange(4)) is None
    arrays.write(path, {"frames": np.array(["a"] * 4)})
    refused(lambda: arrays.read(path, lambda _: True), "frames must be at most 3")


def jpeg_of_two_sizes(claimed: int, real: int) -> bytes:
    """A JPEG that reads as small where the byte that fills up before a marker is taken for a marker."""
    stream = BytesIO()
    Image.new("RGB", (64, 64)).save(stream, "JPEG")
    whole = bytearray(stream.getvalue())
    frame = whole.index(b"\xff\xc0")
    whole[frame + 5 : frame + 9] = 2 * real.to_bytes(2, "big")
    comment = bytearray(b"\xff\xff\xfe\xff\xff") + bytes(0xFFFF - 2)
    at = 2 + 0xFEFF  # where the length FE FF leads to, from the marker FF FF
    comment[at : at + 9] = b"\xff\xc0\x00\x11\x08" + 2 * claimed.to_bytes(2, "big")
    return bytes(whole[:2] + comment + whole[2:])


def test_jpegs_of_two_sizes_are_refused_before_they_are_decoded(tmp_path: Path, refused: Callable[..., str]) -> None:
    content = jpeg_of_two_sizes(64, 30_000)
    (tmp_path / "0001.jpg").write_bytes(content)
    with memory(500):
        refused(lambda: epic_images._decode_epic_image(PATH, "", content), "30000 x 30000")
        refused(lambda: footage.ImageFolder.open(tmp_path).image(0), "30000 x 30000")


@pytest.mark.parametrize("text", ["a: !!timestamp x", 'a: !!int ""', "a: !!bool x", "a: !!float x", "? [a]\n: b"])
def test_yaml_that_is_no_value_is_refused(tmp_path: Path, refused: Callable[..., str], text: str) -> None:
    (tmp_path / "a.yml").write_text(text)
    refused(lambda: read_yaml(tmp_path / "a.yml"), "a.yml")


def test_yaml_that_takes_long_is_refused_by_its_size(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "a.yml").write_text("a: [" + "a," * 500_000 + "]")
    refused(lambda: read_yaml(tmp_path / "a.yml"), "bytes")


@pytest.mark.parametrize("faces", ["f" + " 1" * 3_000_000 + "\n", ("f " + "1 " * 250_000 + "\n") * 4])
@pytest.mark.slow
def test_meshes_beyond_bounds_are_refused(
    refused: Callable[..., str], faces: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(obj, "MAX_OBJ_ELEMENTS", 2**19)
    content = ("v 0 0 0\n" * 3 + faces).encode()
    with memory(100):
        refused(lambda: parse_obj(PATH, content), "at most")


def test_meshes_of_no_node_take_no_memory(tmp_path: Path) -> None:
    trimesh.creation.icosphere(5, 0.1).export(tmp_path / "a.glb")
    document, numbers = glb_parts((tmp_path / "a.glb").read_bytes())
    tree = json.loads(document)
    tree["meshes"] *= 300
    (tmp_path / "b.glb").write_bytes(glb(json.dumps(tree).encode(), numbers))
    read_mesh(tmp_path / "a.glb")  # what is loaded and compiled for it
    with memory(50):
        assert len(read_mesh(tmp_path / "b.glb").faces) == 20 * 4**5


def test_plain_meshes_are_read_alike_either_way() -> None:
    rng = np.random.default_rng(0)
    points = "".join(f"v {x!r} {y!r} {z!r}\r\n" for x, y, z in rng.normal(size=(50, 3)).tolist())
    for corners in ("{} {} {}", "{0}/1 {1}/1 {2}/1", "{0}//7 {1}//7 {2}//7", "{0}/1/7 {1}/1/7 {2}/1/7"):
        faces = "".join(f"f {corners.format(*ids)}\n" for ids in rng.integers(1, 51, (70, 3)).tolist())
        content = f"# v 1 2 3\nmtllib x\n{points}vn 0 0 1\n{faces}".encode()
        plain, by_line = obj._parse_triangles_fast(content), obj._parse_obj_lines(PATH, content)
        assert plain is not None
        assert all(np.array_equal(a, b) for a, b in zip(plain, by_line, strict=True))
    for other in ("f 1 2 3 4\n", "f -1 -2 -3\n", "v 1 2 3 0.5 0.5 0.5\n", " v 1 2 x\n", "v 1 2 3 \\\n"):
        assert obj._parse_triangles_fast(points.encode() + other.encode()) is None


def test_json_with_half_a_character_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    for n, content in enumerate((rb'{"a": "\ud800"}', b'{"a": "\xed\xa0\x80"}', rb'{"\uDC00": 1}')):
        (tmp_path / f"{n}.json").write_bytes(content)
        refused(lambda path=tmp_path / f"{n}.json": files.read_json(path), "invalid JSON")
    (tmp_path / "whole.json").write_text(r'{"a": "\ud83d\ude00"}')
    assert files.read_json(tmp_path / "whole.json") == {"a": "\U0001f600"}


def test_messages_move_no_cursor_and_are_short() -> None:
    message = str(InputError("a\x1b[2J.json", "k", "\x9b31m\u202e" + 9000 * "x", "b\r\nc"))
    assert message.isprintable()
    assert len(message) < 700


def test_a_zip_of_json_with_too_many_members_is_not_listed(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.zip"
    for count in (3, 4):
        with zipfile.ZipFile(path, "w") as archive:
            for n in range(count):
                archive.writestr(f"{n}.txt" if n else "a.json", '{"b": {}}')
        for length in (5, 2**20):  # entries that lie across two pieces are counted, too
            with monkeypatch.context() as patch:
                patch.setattr(arrays, "MAX_ARCHIVE_MEMBERS", 3)
                patch.setattr(arrays, "ZIP_SEARCH_BYTES", length)
                if count == 3:
                    assert streams.read_json_member(path, "b") == {}
                    continue
                refused(lambda: streams.read_json_member(path, "b"), "more than 3 members")
                refused(lambda: arrays.open_archive_bytes(path, path.read_bytes()), "more than 3 members")


@pytest.mark.slow
def test_a_small_zip_of_much_json_ends_soon(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.json", '{"' + "a" * 4_000_000 + '": [' + "1," * 1_900_000 + '1], "b": [' + "{}," * 600_000)
    with memory(400):
        refused(lambda: list(streams.stream_items(path, "b")), "a.zip")


def test_a_version_that_is_a_record_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    arrays.write(tmp_path / "p.npz", {"version": np.zeros((), dtype=[("a", "i8")])})
    refused(lambda: read_learnt(tmp_path / "p.npz"), "version")


def test_a_category_that_moves_the_cursor_is_refused(clip_folder: Path, refused: Callable[..., str]) -> None:
    path = clip_folder / "clip.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"category": "mug\x1b[2J"}))
    refused(lambda: read_clip(clip_folder), "category")


def test_a_damaged_cache_of_mano_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "mano.npz").write_bytes(b"PK\x03\x04 damaged")
    assert mano._read_mano_cache(tmp_path / "mano.npz") is None


def store_with(path: Path, *statements: str) -> Path:
    Store(path).close()
    with sqlite3.connect(path) as db:
        for statement in statements:
            db.execute(statement)
    return path


VALUES = "INSERT INTO versions (change, tab, at, mark, task, annotator, start, deleted) VALUES ('c', 't', 'now', {}, 0)"
KEYFRAME = (
    "INSERT INTO keyframe_versions (change, tab, at, keyframe, task, annotator, grasp, frame, joints, outlines, "
    "hidden, deleted) VALUES ('c', 't', 'now', 'k', 'v', 'ann', 'g', 3, {}, 0, 0)"
)


def test_a_database_with_a_view_of_a_strangers_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    endless = "WITH RECURSIVE n(i) AS (VALUES(1) UNION ALL SELECT i FROM n) SELECT i FROM n"
    path = store_with(tmp_path / "a.sqlite", "DROP VIEW marks", f"CREATE VIEW marks AS {endless}")
    refused(lambda: Store(path), "other tables or views")


@pytest.mark.parametrize(
    "statement",
    [
        VALUES.format("'m', 't', 'ann', 'soon'"), VALUES.format("'m', 't', x'00ff', 1"),
        VALUES.format("'m', CAST(x'ff' AS TEXT), 'ann', 1"), VALUES.format("'m', 't', '../../x', 1"),
        KEYFRAME.format("'{', '{}'"), KEYFRAME.format("'{\"99\": [1, 2]}', '{}'"), KEYFRAME.format("'[]', '{}'"),
        KEYFRAME.format("'{}', '{\"outline-0001\": {\"of\": \"object\"}}'"), KEYFRAME.format("'{}', x'ff'"),
    ],
)  # fmt: skip
def test_contents_that_nobody_has_written_are_refused(
    tmp_path: Path, refused: Callable[..., str], statement: str
) -> None:
    store = Store(store_with(tmp_path / "a.sqlite", statement))
    refused(lambda: [*store.marks.standing(), *store.keyframes.standing()], "a.sqlite", "damaged")
    store.close()


@pytest.mark.parametrize("ends", ["\n", "\r", "\r\n"])
@pytest.mark.parametrize("kind", ["v 0 0 0", "\tf 1 2 3", "f 1/1 2/2 3/3 4/4"])
def test_obj_lines_are_counted_before_they_are_parsed(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str], kind: str, ends: str
) -> None:
    monkeypatch.setattr(obj, "MAX_OBJ_ELEMENTS", 10)
    for parser in ("_parse_triangles_fast", "_parse_obj_lines"):
        monkeypatch.setattr(obj, parser, None)
    content = (ends + kind) * 11
    refused(lambda: parse_obj(Path("x.obj"), content.encode()), "x.obj", "more than 10 lines")


def test_regions_of_a_frame_are_counted_before_they_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    width, height = 40, 30
    monkeypatch.setattr(mask_regions, "MAX_DRAWN_PIXELS", 5 * width * height)
    full = {"size": [height, width], "counts": [0, width * height]}
    path = tmp_path / "coco.json"

    def read(count: int) -> int:
        annotations = [{"id": k, "image_id": 1, "category_id": 1, "segmentation": full} for k in range(count)]
        image = {"id": 1, "file_name": "000000.png", "width": width, "height": height}
        path.write_text(json.dumps({"images": [image], "annotations": annotations}))
        request = MaskRequest(("000000",), (width, height))
        return int(open_masks(path, request)(0).object.sum())

    assert read(5) == width * height
    refused(lambda: read(6), "annotations", "6 regions in one frame", "at most 5")
    corners = [0, 0, width, 0, width, height, 0, height]
    assert mask_regions.fill_polygons(path, "", [corners] * 5, (width, height)).all()
    refused(
        lambda: mask_regions.fill_polygons(path, "k", [corners] * 6, (width, height)),
        "polygons of more pixels",
        "at most",
    )
