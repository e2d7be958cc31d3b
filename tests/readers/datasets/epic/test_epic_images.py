"""EPIC-KITCHENS' images from videos, folders and archives: the requested ones, and no harm from hostile files."""

from __future__ import annotations

import gzip
import io
import tarfile
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.errors import InputError
from getagrip.readers.datasets.epic.epic_images import FrameArchive, Frames, Video
from helpers.environment import Run
from helpers.epic_files import NAME, V, import_epic


def test_frames_of_a_video_are_those_at_their_times(tmp_path: Path) -> None:
    """59.94 images a second, numbered at 60, as EPIC-55 has them: each number is the image shown at its time."""
    import av

    video, rate, count = "P01_01", 60_000 / 1001, 250
    with av.open(str(tmp_path / f"{video}.MP4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(60_000, 1001))
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 64, 48, "yuv420p", 400_000
        for n in range(count):
            image = np.zeros((48, 64, 3), np.uint8)
            image[:, :32], image[:, 32:] = 16 * (n // 16), 16 * (n % 16)  # its number, in two digits
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    numbers = [1, 2, 150, 151, 249]
    for number, image in zip(numbers, Video(tmp_path, video)(numbers), strict=True):
        assert image.shape == (480, 854, 3)
        digits = np.round(np.array([image[:, :400].mean(), image[:, 450:].mean()]) / 16)
        assert 16 * digits[0] + digits[1] == round((number - 1) / 60 * rate)
    with pytest.raises(InputError, match="no frame 5000"):
        Video(tmp_path, video)([200, 5000])
    with pytest.raises(InputError, match=r"P09_01\.MP4"):
        Video(tmp_path, "P09_01")([1])
    (tmp_path / "P08_01.MP4").write_bytes(b"no video")
    with pytest.raises(InputError, match="does not decode"):
        Video(tmp_path, "P08_01")([1])


def test_a_huge_image_is_refused_by_its_header(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / V).mkdir()
    path = tmp_path / V / "frame_0000000001.jpg"
    content = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    at = content.index(b"\xff\xc0")
    content[at + 5 : at + 9] = b"\xff\xff\xff\xff"
    path.write_bytes(content)
    refused(lambda: Frames(tmp_path, V)([1]), str(path), "65535 x 65535")


SUBJECT = V.partition("_")[0]


def jpeg(value: int) -> bytes:
    return cv2.imencode(".jpg", np.full((256, 456, 3), value, np.uint8))[1].tobytes()


def packed(frames: dict[str, bytes], form: int = tarfile.USTAR_FORMAT) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=form) as archive:
        for name, content in frames.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()


@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
@pytest.mark.parametrize("prefix", ["./", "", f"{V}/"])
@pytest.mark.parametrize("place", [f"{SUBJECT}/rgb_frames", SUBJECT, "."])
def test_archives_hold_what_folders_hold(tmp_path: Path, form: int, prefix: str, place: str) -> None:
    (tmp_path / "unpacked" / V).mkdir(parents=True)
    (tmp_path / "tars" / place).mkdir(parents=True)
    frames = {f"{prefix}frame_{n:010d}.jpg": jpeg(30 * n) for n in range(1, 8)}
    for n, content in enumerate(frames.values(), start=1):
        (tmp_path / "unpacked" / V / f"frame_{n:010d}.jpg").write_bytes(content)
    others = {"./": b"", "notes.txt": b"x" * 1000, f"{prefix}thumb_0000000003.jpg": jpeg(0)}
    (tmp_path / "tars" / place / f"{V}.tar").write_bytes(packed(others | frames, form))
    numbers = [5, 2, 2, 7]
    for one, other in zip(
        Frames(tmp_path / "tars", V)(numbers), Frames(tmp_path / "unpacked", V)(numbers), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(InputError, match=rf"{V}\.tar: frame_0000000009\.jpg"):
        Frames(tmp_path / "tars", V)([9])


@pytest.mark.slow
def test_clips_come_from_archives_as_from_folders(run: Run, epic_folder: Path, tmp_path: Path) -> None:
    assert import_epic(run, epic_folder, "--out", tmp_path / "a")[0] == 0
    folder = epic_folder / "images" / SUBJECT / "rgb_frames" / V
    with tarfile.open(folder.with_name(f"{V}.tar"), "w") as archive:
        archive.add(folder, ".")
    before = sorted(folder.parent.iterdir())
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    assert import_epic(run, epic_folder, "--out", tmp_path / "b")[0] == 0
    assert [path for path in before if path != folder] == sorted(folder.parent.iterdir())  # nothing was unpacked
    one, other = ((tmp_path / place / NAME / "frames") for place in "ab")
    assert [p.read_bytes() for p in sorted(one.iterdir())] == [p.read_bytes() for p in sorted(other.iterdir())]


def test_of_a_frame_that_is_there_twice_the_last_counts(tmp_path: Path) -> None:
    once = packed({"frame_0000000001.jpg": b"old"})[:1024]
    (tmp_path / "a.tar").write_bytes(once + packed({"./frame_0000000001.jpg": b"new!"}))
    assert FrameArchive(tmp_path / "a.tar").read(1, 10) == b"new!"


def test_hostile_archives_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / f"{V}.tar"
    whole = packed({"./frame_0000000001.jpg": jpeg(9), "./frame_0000000002.jpg": jpeg(90)})
    link = tarfile.TarInfo("frame_0000000001.jpg")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    negative = bytearray(whole[:512])
    negative[124:136] = b"\xff" * 12  # base 256: -1
    negative[148:156] = b" " * 8
    negative[148:156] = f"{sum(negative):06o}\0 ".encode()
    huge = tarfile.TarInfo("frame_0000000001.jpg")
    huge.size = 2**40
    for content in (
        b"",
        whole[: len(whole) // 4],
        gzip.compress(whole),
        whole[:100] + b"\0\0" + whole[102:],
        link.tobuf() + bytes(1024),
        bytes(negative) + bytes(1024),
        huge.tobuf() + bytes(1024),
        b"\xff" * 5000,
    ):
        path.write_bytes(content)
        refused(lambda: Frames(tmp_path, V)([1]), str(path))
    path.write_bytes(packed({"./frame_0000000001.jpg": b"\xff\xd8 no image"}))
    refused(lambda: Frames(tmp_path, V)([1]), str(path), "frame_0000000001.jpg", "JPEG")
    path.write_bytes(packed({"./frame_0000000001.jpg": bytes(17 * 2**20)}))
    refused(lambda: Frames(tmp_path, V)([1]), str(path), "at most")


@given(st.data())
def test_damaged_archives_give_an_image_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("tar") / f"{V}.tar"
    content = bytearray(packed({f"./frame_{n:010d}.jpg": jpeg(20 * n) for n in range(1, 4)}))
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with suppress(InputError):
        (image,) = Frames(path.parent, V)([2])
        assert image.shape == (480, 854, 3)
