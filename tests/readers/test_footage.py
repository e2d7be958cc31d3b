"""Frames by index are the frames that were written, whatever the container."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.readers.datasets.epic.epic_images import Video as EpicVideo
from getagrip.readers.footage import ImageFolder, VideoFootage, duration_seconds, encode_footage_jpeg
from getagrip.readers.video import ImageCache
from getagrip.studio.store.tasks import open_footage
from helpers.labelled_scene import BITS, NUMBERED_FRAMES, number_in, picture, write_images, write_video

UNEVEN = [40 + n + n * n // 30 for n in range(NUMBERED_FRAMES)]


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
@pytest.mark.parametrize("times", [None, UNEVEN], ids=["even", "uneven"])
@pytest.mark.slow
def test_every_frame_is_the_one_written(tmp_path: Path, suffix: str, times: list[int] | None) -> None:
    video = VideoFootage(write_video(tmp_path / f"a.{suffix}", times))
    assert video.frames == NUMBERED_FRAMES
    order = (
        list(range(NUMBERED_FRAMES))
        + list(range(NUMBERED_FRAMES - 1, -1, -4))
        + random.Random(0).sample(range(NUMBERED_FRAMES), 12)
    )
    for n in order:
        video.shown.cache = ImageCache(len, limit=1)  # nothing kept: every frame is decoded
        assert number_in(video.jpeg(n)) == n
    written = times or list(range(37, 37 + NUMBERED_FRAMES))
    for n in (0, 1, 30, NUMBERED_FRAMES - 1):
        assert video.time(n) == pytest.approx((written[n] - written[0]) / 30, abs=2e-3)
    video.close()


def test_a_gif_is_a_video(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.gif"), "w") as container:
        stream = container.add_stream("gif", rate=10)
        stream.width, stream.height, stream.pix_fmt = 32 * BITS, 64, "rgb8"
        for n in range(12):
            frame = av.VideoFrame.from_ndarray(picture(n), format="rgb24")
            container.mux(stream.encode(frame.reformat(format="rgb8")))
        container.mux(stream.encode())
    video = VideoFootage(tmp_path / "a.gif")
    assert video.frames == 12
    assert [number_in(video.jpeg(n)) for n in (7, 0, 11, 3)] == [7, 0, 11, 3]


@pytest.mark.parametrize("pixels", ["yuv420p", "yuv420p10le"])
def test_a_video_that_lies_on_its_side_is_shown_upright(tmp_path: Path, pixels: str) -> None:
    """As phones write it: turned pixels, the turn in the track's matrix; of 8 bits or 10."""
    upright = np.full((64, 48, 3), 20, np.uint8)
    upright[:32, :24] = 230
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        for _ in range(3):
            image = np.ascontiguousarray(np.rot90(upright))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    content = bytearray(path.read_bytes())
    matrix = content.index(b"tkhd") + 44
    content[matrix : matrix + 36] = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    shown = VideoFootage(path).image(0)
    assert shown.shape == upright.shape
    assert np.abs(shown.astype(int) - upright).mean() < 6.0


@pytest.mark.parametrize("cut", [5, 23, 30])
def test_a_video_that_was_cut_without_encoding_it_anew_shows_each_frame(tmp_path: Path, cut: int) -> None:
    """Its key frame lies in the part that an edit list leaves out: of a short rest, none lies in what is shown."""
    whole, rest = write_video(tmp_path / "whole.mp4", frames=40), tmp_path / "rest.mp4"
    with av.open(str(whole)) as source, av.open(str(rest), "w") as container:
        stream = container.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.pts is not None and packet.dts is not None]
        begin = sorted(packet.pts for packet in packets)[cut]
        for packet in packets:
            packet.pts, packet.dts, packet.stream = packet.pts - begin, packet.dts - begin, stream
            container.mux(packet)
    video = VideoFootage(rest)
    assert video.frames == 40 - cut
    assert [number_in(video.jpeg(n)) for n in (9, 0, 3, 8)] == [cut + 9, cut, cut + 3, cut + 8]


def test_a_container_that_mixes_up_times_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    """AVI has no presentation times: the wrong frames would be shown."""
    refused(lambda: VideoFootage(write_video(tmp_path / "a.avi")).jpeg(20), "convert the video")


def test_the_file_has_b_frames_and_starts_late(tmp_path: Path) -> None:
    """What the test above relies on."""
    with av.open(str(write_video(tmp_path / "a.mkv"))) as container:
        stream = container.streams.video[0]
        kinds = {int(frame.pict_type) for frame in container.decode(stream)}
        assert av.video.frame.PictureType.B in kinds
        assert stream.start_time * stream.time_base > 1.0


def test_steps_back_come_from_the_cache_which_is_bounded(tmp_path: Path) -> None:
    video = VideoFootage(write_video(tmp_path / "a.mp4"))
    video.jpeg(40)
    assert {38, 39, 40} <= video.shown.cache.images.keys()
    cache = ImageCache(len, limit=100)
    for n in range(50):
        cache.put(n, bytes(30))
        assert cache.cached_bytes == sum(map(len, cache.images.values())) <= 100
    assert cache.get(49) is not None
    assert cache.get(0) is None
    cache.put(1, bytes(1000))
    assert cache.get(1) is not None  # what was asked for is there even where it is too large


def test_whole_images_are_those_that_are_shown(tmp_path: Path) -> None:
    video = VideoFootage(write_video(tmp_path / "a.mp4"))
    folder = ImageFolder.open(write_images(tmp_path / "P01_01", [7, 8, 9]))
    for footage, n, number in ((video, 50, 50), (video, 20, 20), (video, 33, 33), (folder, 2, 9)):
        image = footage.image(n)
        assert image.shape == (*footage.size[::-1], 3) == (64, 32 * BITS, 3)
        assert number_in(encode_footage_jpeg(image[..., ::-1])) == number
    video.close()


def test_seconds_count_the_last_frame(tmp_path: Path) -> None:
    video = VideoFootage(write_video(tmp_path / "a.mp4"))
    assert duration_seconds(video, 0, NUMBERED_FRAMES - 1) == pytest.approx(NUMBERED_FRAMES / 30, abs=1e-3)
    assert duration_seconds(video, 5, 5) == pytest.approx(1 / 30, abs=1e-3)


@pytest.mark.parametrize(("name", "fps"), [("P01_01", 60), ("P01_101", 50), ("own", 30)])
def test_numbers_come_back_to_their_frames(tmp_path: Path, name: str, fps: int) -> None:
    video = VideoFootage(write_video(tmp_path / f"{name}.mp4", fps=fps))
    assert [video.number(n) for n in range(NUMBERED_FRAMES)] == list(range(1, NUMBERED_FRAMES + 1))
    assert [video.index(video.number(n)) for n in range(NUMBERED_FRAMES)] == list(range(NUMBERED_FRAMES))
    assert video.index(10**6) == NUMBERED_FRAMES - 1


def test_numbers_are_those_of_the_reader_of_epic(tmp_path: Path) -> None:
    """30 frames per second, numbered 60 times: the frames that the importer takes are those that were marked."""
    path = write_video(tmp_path / "P01_01.mp4")
    video = VideoFootage(path)
    chosen = [1, 2, 30, 31, 64, 101]
    for number, image in zip(chosen, EpicVideo(tmp_path, "P01_01")(chosen), strict=True):
        _, jpeg = cv2.imencode(".png", image[..., ::-1])
        assert number_in(jpeg.tobytes()) == video.index(number)
    assert [video.index(video.number(n)) for n in range(NUMBERED_FRAMES)] == list(range(NUMBERED_FRAMES))


def test_a_folder_counts_by_the_numbers_in_its_names(tmp_path: Path) -> None:
    folder = open_footage(write_images(tmp_path / "frames", [99, 100, 101, 110]))
    assert isinstance(folder, ImageFolder)
    assert [folder.number(n) for n in range(folder.frames)] == [99, 100, 101, 110]
    assert [folder.index(n) for n in (1, 99, 101, 107, 500)] == [0, 0, 2, 3, 3]
    assert number_in(folder.jpeg(3)) == 110
    assert duration_seconds(folder, 0, 3) == pytest.approx(12 / 30)


def test_images_without_numbers_count_from_1(tmp_path: Path) -> None:
    for n, name in enumerate(("a", "b", "c")):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((8, 8, 3), 60 * n, np.uint8))
    folder = ImageFolder.open(tmp_path)
    assert folder.numbers == (1, 2, 3)


def test_bad_footage_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "text.mp4").write_text("#EXTM3U\n#EXTINF:1,\n/etc/hostname\n")
    refused(lambda: VideoFootage(tmp_path / "text.mp4"), "text.mp4", "a video")
    refused(lambda: open_footage(tmp_path / "absent.mp4"), "absent.mp4")
    (tmp_path / "empty").mkdir()
    refused(lambda: open_footage(tmp_path / "empty"), "0 images")
    (tmp_path / "empty" / "a1.jpg").write_bytes(b"\xff\xd8\xff\xe0no image")
    refused(lambda: open_footage(tmp_path / "empty").jpeg(0), "a1.jpg")
    huge = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()
    header = huge[12:16] + (10**5).to_bytes(4, "big") * 2 + huge[24:29]
    huge = huge[:12] + header + zlib.crc32(header).to_bytes(4, "big") + huge[33:]
    (tmp_path / "empty" / "a1.jpg").write_bytes(huge)
    refused(lambda: open_footage(tmp_path / "empty").jpeg(0), "100000 x 100000")


def test_damaged_videos_are_refused_and_the_rest_is_shown(tmp_path: Path) -> None:
    content = write_video(tmp_path / "a.mkv").read_bytes()
    rng = random.Random(1)
    for k in range(12):
        damaged = bytearray(content[: len(content) * (k + 1) // 12])
        for _ in range(20):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        path = tmp_path / f"{k}.mkv"
        path.write_bytes(damaged)
        try:
            video = VideoFootage(path)
            for n in range(0, video.frames, 9):
                video.jpeg(n)
        except InputError:
            continue
