"""Bounds hold for what a file becomes, not for what its header says: images, videos, HDF5, Parquet."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from fractions import Fraction
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from getagrip.clip import depth
from getagrip.errors import InputError
from getagrip.readers import streams, video
from getagrip.readers.trackers.egodex import EGODEX_JOINTS, read_egodex_joints
from helpers import program_files

h5py: Any = import_module("h5py") if find_spec("h5py") else None
CAMERA = "transforms/camera"


@pytest.mark.parametrize("bound", ["MAX_EXR_BLOCK_BYTES", "MAX_EXR_BYTES"])
def test_channels_count_with_the_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str) -> None:
    channels = {name: np.ones((32, 10), "<f4") for name in "AZ"}
    (tmp_path / "a.exr").write_bytes(program_files.exr(channels))
    most = 2 * 4 * 10 * (16 if bound == "MAX_EXR_BLOCK_BYTES" else 32)
    monkeypatch.setattr(depth, bound, most)
    assert depth.read_channel(tmp_path / "a.exr", 1000).shape == (32, 10)
    monkeypatch.setattr(depth, bound, most - 1)
    with pytest.raises(InputError, match="channels must be blocks"):
        depth.read_channel(tmp_path / "a.exr", 1000)


def film(width: int, height: int, aspect: int = 1, codec: str = "mpeg4", kind: str = "mp4") -> bytes:
    """A video of two frames."""
    content = BytesIO()
    with av.open(content, "w", format=kind) as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(aspect, 1)
        for value in (50, 200):
            image = np.full((height, width, 3), value, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return content.getvalue()


def test_a_video_is_as_wide_as_it_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(film(64, 48, 15))
    assert video.video_info(path).size == (960, 48)
    monkeypatch.setattr(video, "MAX_CLIP_IMAGE_PIXELS", 959 * 48)
    with pytest.raises(InputError, match="size must be at most"):
        video.open_video(path)


def test_later_frames_of_a_video_may_not_be_larger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "MAX_CLIP_IMAGE_PIXELS", 20_000)
    small, large = (film(*size, codec="libx264", kind="h264") for size in ((64, 48), (320, 240)))
    (tmp_path / "a.h264").write_bytes(small + large)
    with av.open(tmp_path / "a.h264") as read, av.open(tmp_path / "a.ts", "w", format="mpegts") as written:
        stream = written.add_stream_from_template(read.streams.video[0])
        for n, packet in enumerate(packet for packet in read.demux() if packet.size):
            packet.stream, packet.pts, packet.dts, packet.time_base = stream, 3000 * n, 3000 * n, Fraction(1, 90_000)
            written.mux(packet)
    shapes = []
    with pytest.raises(InputError, match="does not decode"):
        shapes += [image.shape for image in video.video_frames(tmp_path / "a.ts", 1, 4)]
    assert (240, 320, 3) not in shapes


@pytest.fixture
def episode(tmp_path: Path) -> Path:
    """An episode of EgoDex whose camera is left out."""
    if h5py is None:
        pytest.skip("the extra egodex is not installed")
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 2, 3] = 0.4
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for joint in EGODEX_JOINTS:
            file[f"transforms/right{joint}"] = poses
    with h5py.File(tmp_path / "other.hdf5", "w") as file:
        file["secret"] = poses
    return tmp_path / "a.hdf5"


def plain(file: Any, **more: Any) -> Any:
    return file.create_dataset(CAMERA, **({"data": np.tile(np.eye(4), (30, 1, 1))} | more))


def soft(file: Any) -> None:
    file["x"] = h5py.ExternalLink("other.hdf5", "/secret")
    file[CAMERA] = h5py.SoftLink("/x")


def soft_group(file: Any) -> None:
    file["y"] = file["transforms"]
    plain(file)
    del file["transforms"]
    file["transforms"] = h5py.SoftLink("/y")


def virtual(file: Any) -> None:
    layout = h5py.VirtualLayout((30, 4, 4), float)
    layout[:] = h5py.VirtualSource("other.hdf5", "secret", (30, 4, 4))
    file.create_virtual_dataset(CAMERA, layout)


def external(file: Any) -> None:
    file.create_dataset(CAMERA, (30, 4, 4), float, external=[("other.hdf5", 0, h5py.h5f.UNLIMITED)])


def of_type(dtype: Any) -> Callable[[Any], object]:
    return lambda file: file.create_dataset(CAMERA, (30, 4, 4), dtype, chunks=(1, 4, 4))


def bomb(file: Any) -> None:
    data = plain(file, chunks=(30, 4, 4), compression="gzip")
    data.id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(40 * 2**20)))


BAD = {
    "a soft link": soft, "a soft link above": soft_group, "virtual": virtual, "external": external,
    "texts": of_type("S10"), "records": of_type([("a", "f4")]), "arrays": of_type(np.dtype((float, (100, 100)))),
    "complex": of_type(complex), "references": lambda file: file.create_dataset(CAMERA, (30, 4, 4), h5py.ref_dtype),
    "strings": lambda file: file.create_dataset(CAMERA, (30, 4, 4), h5py.string_dtype()),
    "empty": lambda file: file.create_dataset(CAMERA, data=h5py.Empty(float)),
    "a group": lambda file: file.create_group(CAMERA), "a type": lambda file: file.__setitem__(
        CAMERA, np.dtype(float)),
    "another filter": lambda file: plain(file, compression="lzf"), "a bomb": bomb,
    "too many": lambda file: file.create_dataset(CAMERA, (10**9, 4, 4), float, chunks=(10, 4, 4)),
    "large parts": lambda file: file.create_dataset(
        CAMERA, (30, 4, 4), float, chunks=(300_000, 4, 4), maxshape=(None, 4, 4)),
    "infinite": lambda file: plain(file, data=np.full((30, 4, 4), math.inf)), "none": lambda _: None,
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_poses_of_egodex_are_numbers_in_the_file(episode: Path, kind: str) -> None:
    with h5py.File(episode, "a") as file:
        BAD[kind](file)
    with pytest.raises(InputError, match="transforms"):
        read_egodex_joints(episode, "right")


@pytest.mark.parametrize(
    "how", [{}, {"compression": "gzip", "shuffle": True, "fletcher32": True}, {"chunks": (7, 4, 4)}, {"dtype": "f4"}]
)
def test_poses_of_egodex_may_be_packed(episode: Path, how: dict[str, Any]) -> None:
    with h5py.File(episode, "a") as file:
        plain(file, **how)
    np.testing.assert_allclose(read_egodex_joints(episode, "right"), np.tile([0.0, 0.0, 0.4], (30, 21, 1)))


def test_damaged_episodes_are_an_error_or_other_numbers(episode: Path) -> None:
    with h5py.File(episode, "a") as file:
        plain(file)
    whole, rng = episode.read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(damaged) // 4, 20):
            damaged[at] = rng.integers(256)
        episode.write_bytes(bytes(damaged))
        try:
            assert read_egodex_joints(episode, "right").shape[1:] == (21, 3)
        except InputError as error:
            assert str(episode) in str(error)  # noqa: PT017


def table(path: Path, **columns: Any) -> Path:
    pa = pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from pyarrow.parquet import write_table

    write_table(pa.table(columns), path)
    return path


def test_columns_are_numbers_nan_where_there_is_none(tmp_path: Path) -> None:
    path = table(tmp_path / "a.parquet", n=[3, 4, None], h=[[1.0, None], None, [2.0, 3.0]], e=[1, 1, 2])
    found = streams.read_columns(path, ["n", "h"])
    np.testing.assert_array_equal(found["n"], [3.0, 4.0, np.nan])
    np.testing.assert_array_equal(found["h"], [[1.0, np.nan], [np.nan, np.nan], [2.0, 3.0]])
    kept = streams.read_columns(path, ["h", "e"], ("e", 1))
    np.testing.assert_array_equal(kept["h"], [[1.0, np.nan], [np.nan, np.nan]])
    deep = table(tmp_path / "b.parquet", h=[[[1.0, 2.0], [3.0, 4.0]], None])
    np.testing.assert_array_equal(streams.read_columns(deep, ["h"])["h"], [[1.0, 2.0, 3.0, 4.0], 4 * [np.nan]])


@pytest.mark.parametrize(
    "column", [["a", "b"], [[1.0], [1.0, 2.0]], [{"a": 1}, {"a": 2}], [[[1.0], None], [[1.0], [2.0]]], [["a"], ["b"]]]
)
def test_other_columns_are_refused(tmp_path: Path, column: list[Any]) -> None:
    with pytest.raises(InputError, match=r"a\.parquet: h "):
        streams.read_columns(table(tmp_path / "a.parquet", h=column), ["h"])


@pytest.mark.parametrize("bound", ["MAX_PARQUET_VALUES_READ", "MAX_PARQUET_VALUES_RETURNED", "MAX_PARQUET_ROW_VALUES"])
def test_rows_are_counted_before_they_take_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str) -> None:
    path = table(tmp_path / "a.parquet", h=np.zeros((3000, 5)).tolist(), e=[0] * 1500 + [1] * 1500)
    most = {"MAX_PARQUET_VALUES_READ": 18_000, "MAX_PARQUET_VALUES_RETURNED": 18_000, "MAX_PARQUET_ROW_VALUES": 3}[
        bound
    ]
    monkeypatch.setattr(streams, bound, most)
    assert streams.read_columns(path, ["h", "e"])["h"].shape == (3000, 5)
    monkeypatch.setattr(streams, bound, most - 1)
    with pytest.raises(InputError, match="numbers"):
        streams.read_columns(path, ["h", "e"])
    if bound == "MAX_PARQUET_VALUES_RETURNED":
        assert streams.read_columns(path, ["h", "e"], ("e", 1))["h"].shape == (1500, 5)
