"""JPEG images from strangers: a scan of a few bytes may take as long as a whole image, so they are counted first."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import InputError

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile

MOST_SCANS = 100
"""Passes over an image: 1 to 4 of plain ones, about 10 of those that load step by step."""
_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])", re.DOTALL)
"""What begins a segment, wherever a decoder looks for one: in coded data, FF is followed by 00 or D0 to D7."""
SCAN, END = 0xDA, 0xD9


def open_jpeg(path: Path, key: str, content: bytes) -> JpegImageFile:
    """A JPEG that is yet to be decoded. ``path`` and ``key`` are named in errors.

    Raises ``InputError`` for too many scans, and whatever Pillow meets.
    """
    from PIL.JpegImagePlugin import JpegImageFile

    scans, at = 0, 2
    while (marker := _MARKER.search(content, at)) and content[marker.start() + 1] != END:
        scans += content[marker.start() + 1] == SCAN
        if scans > MOST_SCANS:
            raise InputError(path, f"{key} scans".strip(), f"more than {MOST_SCANS}", "at most that")
        length = int.from_bytes(content[marker.end() : marker.end() + 2], "big")
        at = marker.end() + max(length, 2)  # as libjpeg goes on; of a scan, before its coded data
    return JpegImageFile(io.BytesIO(content))
