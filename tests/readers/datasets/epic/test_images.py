"""Images of EPIC-KITCHENS' videos: those of the numbers that are asked for, and no harm from hostile ones."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.readers.datasets.epic.epic_images import Frames, Video
from helpers.epic_files import V


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
