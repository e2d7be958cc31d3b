"""Ways to break the small clip in its folder, one at a time."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

Break = Callable[[Path], None]


def edit_json(**changes: object) -> Break:
    """Set keys of clip.json; None removes one."""

    def apply(folder: Path) -> None:
        fields = json.loads((folder / "clip.json").read_text()) | changes
        fields = {key: value for key, value in fields.items() if value is not None}
        (folder / "clip.json").write_text(json.dumps(fields))

    return apply


def replaced(old: str, new: str) -> Break:
    """Replace text in clip.json."""

    def apply(folder: Path) -> None:
        text = (folder / "clip.json").read_text()
        assert old in text
        (folder / "clip.json").write_text(text.replace(old, new))

    return apply


def edit_npz(file: str, **changes: object) -> Break:
    """Set arrays of an .npz; functions are applied to the array that is there; None removes one."""

    def apply(folder: Path) -> None:
        with np.load(folder / file) as loaded:
            arrays = dict(loaded)
        for key, value in changes.items():
            arrays[key] = value(arrays[key].copy()) if callable(value) else value
        np.savez(folder / file, **{key: value for key, value in arrays.items() if value is not None})

    return apply


def edit_png(path: Path, edit: Callable[[np.ndarray], np.ndarray]) -> None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    cv2.imwrite(str(path), edit(image))


def mask(edit: Callable[[np.ndarray], np.ndarray], kind: str = "object") -> Break:
    """Change the mask of frame 0001."""
    return lambda folder: edit_png(folder / "masks" / kind / "0001.png", edit)


def content(file: str, data: bytes | str) -> Break:
    """Replace a file's content."""
    return lambda folder: (folder / file).write_bytes(data if isinstance(data, bytes) else data.encode()) and None


def removed(file: str) -> Break:
    return lambda folder: (folder / file).unlink()


def renamed(old: str, new: str) -> Break:
    return lambda folder: (folder / old).rename(folder / new) and None


def linked_out(file: str) -> Break:
    """Move a file out of the clip and leave a link to it."""

    def apply(folder: Path) -> None:
        (folder / file).rename(folder.parent / "outside")
        os.symlink(folder.parent / "outside", folder / file)

    return apply


def no_object(folder: Path) -> None:
    for path in (folder / "masks" / "object").iterdir():
        edit_png(path, np.zeros_like)


def at(index: tuple[int, ...], value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Set one element of an array."""

    def apply(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return apply


def header_lies(folder: Path) -> None:
    """A hand.npz whose vertices' header promises 10^12 numbers."""
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6, 3)}
    np.lib.format.write_array_header_1_0(stream, header)
    with zipfile.ZipFile(folder / "hand.npz", "w") as archive:
        archive.writestr("vertices.npy", stream.getvalue() + b"\0" * 64)


def bomb(folder: Path) -> None:
    """A hand.npz that says it unpacks to 4 GB: the sizes of a small one, changed in its directory."""
    with zipfile.ZipFile(folder / "hand.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("vertices.npy", b"\0" * 1000)
    data = bytearray((folder / "hand.npz").read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = (0xFFFFFFF0).to_bytes(4, "little")
    (folder / "hand.npz").write_bytes(data)


def png_bomb(folder: Path) -> None:
    """A mask whose header says 60000 x 60000, with a right checksum."""
    from zlib import crc32

    path = folder / "masks/object/0001.png"
    data = bytearray(path.read_bytes())
    data[16:24] = (60000).to_bytes(4, "big") * 2
    data[29:33] = crc32(bytes(data[12:29])).to_bytes(4, "big")
    path.write_bytes(data)


K = [[40.0, 0.0, 16.0], [0.0, 41.0, 12.0], [0.0, 0.0, 1.0]]
EYE = np.tile(np.eye(4), (3, 1, 1))

CAMERA, POSE = K, np.eye(4).tolist()


def at_camera(T_world_cam: object) -> Break:
    """Set the camera's pose in the world."""
    return edit_json(camera={"K": CAMERA, "T_world_cam": T_world_cam})
