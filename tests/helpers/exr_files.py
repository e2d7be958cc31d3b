"""EXR files as OpenCV and others write them: scan lines of one or several channels."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy import ndarray

TYPES = {"<f2": 1, "<f4": 2}


def exr(channels: dict[str, ndarray], compression: int = 3) -> bytes:
    """The bytes of a file: channels (H, W) of float16 or float32; compression 0 none, 2 ZIPS, 3 ZIP."""
    height, width = next(iter(channels.values())).shape
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iiii", TYPES[channels[name].dtype.str], 0, 1, 1)
        for name in sorted(channels)
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in (
            (b"channels", b"chlist", listed + b"\0"),
            (b"compression", b"compression", bytes([compression])),
            (b"dataWindow", b"box2i", window),
            (b"displayWindow", b"box2i", window),
            (b"lineOrder", b"lineOrder", b"\0"),
        )
    )
    start = struct.pack("<ii", 20000630, 2) + header + b"\0"
    lines = {0: 1, 2: 1, 3: 16}[compression]
    blocks = []
    for y in range(0, height, lines):
        rows = range(y, min(y + lines, height))
        plain = b"".join(channels[name][row].tobytes() for row in rows for name in sorted(channels))
        packed = plain if compression == 0 else min(deflated(plain), plain, key=len)
        blocks.append(struct.pack("<ii", y, len(packed)) + packed)
    at = len(start) + 8 * len(blocks) + np.cumsum([0, *map(len, blocks[:-1])])
    return start + struct.pack(f"<{len(blocks)}q", *at) + b"".join(blocks)


def deflated(plain: bytes) -> bytes:
    """Bytes as ZIP stores them: even ones before odd ones, differences of neighbours, deflated."""
    values = np.frombuffer(plain, np.uint8)
    apart = np.concatenate([values[::2], values[1::2]]).astype(int)
    steps = np.concatenate([apart[:1], np.diff(apart) + 128])
    return zlib.compress((steps % 256).astype(np.uint8).tobytes())
