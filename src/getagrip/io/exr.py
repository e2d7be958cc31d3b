"""One channel of an OpenEXR file, as programs write depth: a single image of scan lines, plain or deflated.

OpenCV has no reader unless it was built with one, and that one is switched off since it was unsafe with strangers'
files. Format: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files

EXR_MAGIC, SINGLE_IMAGE = 20000630, 2
"""The first two numbers: OpenEXR, and version 2 without tiles, long names, depth lists or parts."""
EXR_BLOCK_LINES = {0: 1, 2: 1, 3: 16}
"""Lines of a block by the compression: none, ZIPS, ZIP."""
EXR_DTYPES: dict[int, np.dtype[np.floating]] = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
MAX_EXR_BLOCK_BYTES, MAX_EXR_BYTES = 32 * 2**20, 2**30
"""Bytes of a block of lines, all channels of it, and of all blocks, unpacked."""
EXR_DEPTH_CHANNELS = ("Z", "Y", "depth", "depth.Z", "R")
"""Channels that are taken where there are several."""


def read_channel(path: Path, most: int) -> Float[ndarray, "H W"]:
    """Read the channel of distances of an EXR file of at most ``most`` pixels. Raises ``InputError``."""
    content = files.read_bytes(path)
    try:
        return _decode_channel(path, content, most)
    except InputError:
        raise
    except (struct.error, ValueError, KeyError, IndexError, OverflowError, zlib.error) as error:
        raise InputError(path, "", f"a damaged file ({error})", "a whole EXR file") from error


def _decode_channel(path: Path, content: bytes, most: int) -> Float[ndarray, "H W"]:
    if struct.unpack_from("<ii", content) != (EXR_MAGIC, SINGLE_IMAGE):
        raise InputError(path, "", "no EXR file of one image of scan lines", "such a file, as OpenCV writes it")
    header, start = _parse_exr_header(content)
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height, compression = right - left + 1, bottom - top + 1, header["compression"][0]
    if min(width, height) < 1 or width * height > most:
        raise InputError(path, "dataWindow", f"{width} x {height} pixels", f"at most {most} pixels")
    if compression not in EXR_BLOCK_LINES:
        raise InputError(path, "compression", f"kind {compression}", "none, ZIPS or ZIP")
    channels = _parse_channel_types(header["channels"])
    wanted = next((name for name in EXR_DEPTH_CHANNELS if name in channels), next(iter(channels)))
    offsets, row = {}, 0
    for name, dtype in channels.items():  # of each line, all of one channel, then of the next
        offsets[name], row = row, row + dtype.itemsize * width
    lines = EXR_BLOCK_LINES[compression]
    if row * lines > MAX_EXR_BLOCK_BYTES or row * height > MAX_EXR_BYTES:
        got = f"{len(channels)} channels of {width} x {height} pixels"
        raise InputError(
            path, "channels", got, f"blocks of at most {MAX_EXR_BLOCK_BYTES} bytes, {MAX_EXR_BYTES} in all"
        )
    out = np.zeros((height, width))
    for at in struct.unpack_from(f"<{-(-height // lines)}q", content, start):
        y, size = struct.unpack_from("<ii", content, at)
        first = y - top
        count = min(lines, height - first)
        if not 0 <= first < height or size < 0:
            raise ValueError("a block of other lines")
        block = np.frombuffer(_inflate_block(content[at + 8 : at + 8 + size], row * count), np.uint8).reshape(
            count, row
        )
        part = block[:, offsets[wanted] :][:, : channels[wanted].itemsize * width]
        out[first : first + count] = np.ascontiguousarray(part).view(channels[wanted])
    return out


def _parse_exr_header(content: bytes) -> tuple[dict[str, bytes], int]:
    """Return the header's values by their names, and where it ends."""
    header, at = dict[str, bytes](), 8
    while content[at]:
        name, kind = content.index(0, at), content.index(0, content.index(0, at) + 1)
        (size,) = struct.unpack_from("<i", content, kind + 1)
        if size < 0:
            raise ValueError("a negative size")
        header[content[at:name].decode("latin-1")] = content[kind + 5 : kind + 5 + size]
        at = kind + 5 + size
    return header, at + 1


def _parse_channel_types(value: bytes) -> dict[str, np.dtype[np.floating]]:
    """Return the type of each channel, in the order of the file."""
    found: dict[str, np.dtype[np.floating]] = {}
    at = 0
    while value[at]:
        end = value.index(0, at)
        kind, _, x, y = struct.unpack_from("<iiii", value, end + 1)
        if (x, y) != (1, 1):
            raise ValueError("a channel of another size")
        found[value[at:end].decode("latin-1")] = EXR_DTYPES[kind]
        at = end + 17
    return found


def _inflate_block(stored: bytes, size: int) -> bytes:
    """Return the bytes of a block of lines: differences of neighbours, even ones before odd ones, deflated."""
    if len(stored) == size:
        return stored
    inflated = np.frombuffer(zlib.decompressobj().decompress(stored, size + 1), np.uint8)
    if len(inflated) != size:
        raise ValueError("a block of another size")
    values = np.cumsum(inflated, dtype=np.uint8)
    values[1::2] ^= 128  # sums, of which 128 is taken off once for each byte, modulo 256
    out = np.empty(size, np.uint8)
    out[::2], out[1::2] = np.split(values, [(size + 1) // 2])
    return out.tobytes()
