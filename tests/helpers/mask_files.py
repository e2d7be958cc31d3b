"""Files of masks by other programs: label images, COCO, SAM 2."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

SIZE = (20, 14)
FRAMES = ("000003", "000004")


def labels(seed: int = 0) -> ndarray:
    return np.random.default_rng(seed).integers(0, 4, (2, *SIZE[::-1]))


def write_png(path: Path, values: ndarray, depth: int, kind: int, palette: bool = False) -> None:
    """A PNG made by hand: any depth, grey or palette indices."""
    height, width = values.shape

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = b""
    for row in values:
        bits = "".join(f"{int(v):0{depth}b}" for v in row)
        bits += "0" * (-len(bits) % 8)
        rows += b"\0" + bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0))
    if palette:
        content += chunk(b"PLTE", bytes(range(3, 3 + 3 * 2 ** min(depth, 4))))
    path.write_bytes(content + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def label_folder(folder: Path) -> Path:
    folder.mkdir()
    for name, values in zip(FRAMES, labels(), strict=True):
        write_png(folder / f"frame_{int(name)}.png", values, 8, 3, palette=True)
    return folder


def encoded(mask: ndarray, compressed: bool) -> dict[str, Any]:
    """COCO's run lengths, by its own definition."""
    flat = mask.T.ravel()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flat]).astype(int)) != 0)
    counts = np.diff([0, *edges, flat.size]).tolist()
    if not compressed:
        return {"size": list(mask.shape), "counts": counts}
    text = ""
    for i, count in enumerate(counts):
        x = count - counts[i - 2] if i > 2 else count
        more = True
        while more:
            c, x = x & 31, x >> 5
            more = x != -1 if c & 16 else x != 0
            text += chr((c | 32 if more else c) + 48)
    return {"size": list(mask.shape), "counts": text}


def coco(path: Path, compressed: bool = True) -> Path:
    images = [
        {"id": n, "file_name": f"rgb/{name}.jpg", "width": SIZE[0], "height": SIZE[1]} for n, name in enumerate(FRAMES)
    ]
    annotations = [
        {"image_id": n, "category_id": k, "segmentation": encoded(labels()[n] == k, compressed)}
        for n in range(2)
        for k in (1, 2, 3)
    ]
    categories = [{"id": 1, "name": "cup"}, {"id": 2, "name": "hand"}, {"id": 3, "name": "table"}]
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))
    return path


def segments_of(frames: int, kind: Any = bool) -> dict[int, dict[int, ndarray]]:
    """SAM 2's dictionary, as its example collects it."""
    return {n: {k: (labels()[n % 2] == k)[None].astype(kind) for k in (1, 2, 3)} for n in range(frames)}


def youtube_vis(path: Path) -> None:
    """A region of each thing in each frame, and none in some."""
    videos = [{"id": 1, "file_names": [f"take/{name}.jpg" for name in FRAMES], "width": SIZE[0], "height": SIZE[1]}]
    annotations = [
        {
            "id": k, "video_id": 1, "category_id": k,
            "segmentations": [encoded(labels()[n] == k, True) if n or k < 3 else None for n in range(2)],
        }
        for k in (1, 2, 3)
    ]  # fmt: skip
    path.write_text(json.dumps({"videos": videos, "annotations": annotations}))


def label_me(folder: Path) -> None:
    folder.mkdir()
    for name in FRAMES:
        shapes: list[dict[str, Any]] = [
            {"label": "1", "points": [[3, 2], [9, 2], [9, 6]], "shape_type": "polygon", "group_id": 4},
            {"label": "2", "points": [[11, 8], [18, 12]], "shape_type": "rectangle", "group_id": None},
        ]
        content = {"shapes": shapes, "imageWidth": SIZE[0], "imageHeight": SIZE[1]}
        (folder / f"{name}.json").write_text(json.dumps(content))


def masklets(path: Path) -> None:
    """SA-V's, of the frames 0 and 4."""
    listed = [[encoded(labels()[n] == k, True) for k in (1, 2)] for n in range(2)]
    path.write_text(json.dumps({"masklet": listed, "masklet_id": [1, 2], "video_frame_count": 8.0}))


def array_folder(folder: Path) -> None:
    folder.mkdir()
    for name, values in zip(FRAMES, labels(), strict=True):
        np.save(folder / f"mask_{name}.npy", values.astype(np.uint16))
