"""Clips from their folders, every number checked. The format is in docs/formats.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypedDict, cast

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.data import Clip
from getagrip.clip.modality import modalities
from getagrip.clip.naming import number_of
from getagrip.clip.per_frame import CAMERA, frame_names, intrinsics, times, world
from getagrip.clip.plausible import FASTEST, SLOWEST, check_in_view
from getagrip.clip.reading_arrays import HANDS, OTHER_HAND, frames_with_hand, read_hand, read_other_hand, read_truth
from getagrip.clip.timeline import Side, at_frames, read_segments
from getagrip.errors import InputError
from getagrip.geometry.mesh_files import read_mesh
from getagrip.io import files
from getagrip.io.named import named
from getagrip.provenance import Provenance, parse

VERSION = 4
"""Version of the clips that are written; older ones are read, too."""
REQUIRED = ("version", "name", "category", "side", "fps", "frames", "size", "camera", "mesh", "scale")
OPTIONAL = {1: ("provenance",), 2: ("provenance", "times"), 3: ("provenance", "times", "segments")}
OPTIONAL[4] = (*OPTIONAL[3], "depth")
"""Further keys of ``clip.json`` by its version."""
CAMERA_KEYS = {1: CAMERA[:1], 2: CAMERA[:3], 3: CAMERA, 4: CAMERA}
"""Keys of ``camera`` by the version; only the first must be there."""
LARGEST_SIDE, LARGEST_IMAGE = 16384, 40_000_000
"""Plausible side [px] and number of pixels of an image; of video, 8K has the most."""


class ClipFields(TypedDict, total=False):
    """The keys of ``clip.json``."""

    version: int
    name: str
    category: str
    side: Side
    fps: float
    frames: object
    size: object
    camera: dict[str, object]
    mesh: str
    scale: Literal["known", "free"]
    provenance: Provenance
    times: object
    segments: object
    depth: object


@named
def read_clip(folder: str | Path) -> Clip:
    """Read and check a clip, except its masks and images, in the frames that have a hand.

    Args:
        folder: the clip's folder, or the ``clip.json`` in it (docs/formats.md).

    Raises:
        InputError: a file is missing, damaged or impossible. The message names the file and the key.
    """
    folder = _folder(folder)
    path = folder / "clip.json"
    fields = _fields(folder)
    frames = frame_names(path, fields["frames"])
    size = _size(path, fields["size"])
    mesh = read_mesh(_mesh(folder, fields))
    hand_path = files.inside(folder, "hand.npz", "", HANDS)
    rows = frames_with_hand(hand_path, frames)
    hand = read_hand(hand_path, len(rows))
    K = intrinsics(path, fields["camera"], len(frames), size)[rows]
    when = times(path, fields["times"], frames)[rows] if "times" in fields else None
    if when is None and len(rows) < len(frames):
        when = rows / float(fields["fps"])
    where = world(path, fields["camera"], frames)
    segments = read_segments(path, fields.get("segments", []), frames, where is not None)
    check_in_view(folder / "hand.npz", hand, K, size)
    other = read_other_hand(folder, frames, rows, K, size)
    has_truth = (folder / "truth.npz").exists() or (folder / "truth.npz").is_symlink()
    return Clip(
        folder=folder,
        name=fields["name"],
        category=fields["category"],
        side=fields["side"],
        fps=float(fields["fps"]),
        frames=tuple(frames[row] for row in rows),
        size=size,
        K=K,
        mesh=mesh,
        scale=fields["scale"],
        hand=hand,
        truth=read_truth(folder, hand, fields["scale"], mesh) if has_truth else None,
        times=when,
        world=None if where is None else where.take(rows),
        segments=at_frames(segments, rows),
        other_hand=other,
        provenance=fields["provenance"],
    )


@dataclass(frozen=True)
class ClipHeader:
    """The checked content of ``clip.json``, with frames that lack a hand; hands, mesh and masks are not read."""

    folder: Path
    fields: ClipFields
    frames: tuple[str, ...]
    size: tuple[int, int]
    K: Float[ndarray, "T 3 3"]

    @property
    def times(self) -> Float[ndarray, "T"]:
        """(T,) the times of the frames [s]: as stated, or at the clip's rate by their numbers."""
        if "times" in self.fields:
            return np.array(self.fields["times"], dtype=float)
        numbers = [number_of(name) for name in self.frames]
        at = np.arange(len(numbers)) if None in numbers else np.array(numbers) - int(numbers[0] or 0)
        return np.asarray(at / float(self.fields["fps"]))

    def changed(self, new: Mapping[str, object]) -> dict[str, object]:
        """Return the content of ``clip.json``, in today's version, with some new fields."""
        return {**self.fields, **new, "version": VERSION}


def read_header(folder: str | Path) -> ClipHeader:
    """Read the header of a clip, which may lack its hands yet. Raises ``InputError``."""
    folder = _folder(folder)
    fields, path = _fields(folder), folder / "clip.json"
    frames, size = frame_names(path, fields["frames"]), _size(path, fields["size"])
    if "times" in fields:
        times(path, fields["times"], frames)
    where = world(path, fields["camera"], frames)
    read_segments(path, fields.get("segments", []), frames, where is not None)
    return ClipHeader(folder, fields, frames, size, intrinsics(path, fields["camera"], len(frames), size))


def read_name(folder: str | Path) -> str:
    """Read the name of a clip, and check its ``clip.json`` and nothing else. Raises ``InputError``."""
    return _fields(_folder(folder))["name"]


def input_sha256(folder: str | Path) -> str:
    """Compute the checksum of a reconstruction's inputs: ``clip.json``, hands, mesh, evidence; not images, not truth.

    Raises ``InputError`` where one of them is missing.
    """
    folder = _folder(folder)
    fields = _fields(folder)
    hand = files.inside(folder, "hand.npz", "", HANDS)
    frames = frame_names(folder / "clip.json", fields["frames"])
    paths = {"clip.json": folder / "clip.json", "hand.npz": hand, fields["mesh"]: _mesh(folder, fields)}
    if (folder / OTHER_HAND).exists():
        paths[OTHER_HAND] = files.inside(folder, OTHER_HAND, "", HANDS)
    with_hand = [frames[row] for row in frames_with_hand(hand, frames)]
    for name in (name for modality in modalities() for name in modality.files(folder, with_hand)):
        paths[name] = files.inside(folder, name, "", "evidence for each frame of clip.json")
    return files.sha256(paths)


def _folder(path: str | Path) -> Path:
    path = Path(path)
    return path.parent if path.name == "clip.json" else path


def _mesh(folder: Path, fields: ClipFields) -> Path:
    return files.inside(folder, fields["mesh"], "mesh", "a triangle mesh", source=folder / "clip.json")


def _fields(folder: Path) -> ClipFields:
    """Read the fields of ``clip.json``: none missing or unknown, those of one text or number checked."""
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "the folder of a clip")
    path = files.inside(folder, "clip.json", "", "the description of a clip")
    fields = files.read_json(path)
    version = fields.get("version", VERSION)
    if type(version) is not int or version not in OPTIONAL:
        raise InputError(path, "version", files.shown(version), " or ".join(map(str, OPTIONAL)))
    _known(path, "", fields, (*REQUIRED, *OPTIONAL[version]), version)
    missing = next((key for key in REQUIRED if key not in fields), None)
    if missing is not None:
        raise InputError(path, missing, "no such key", "the key")

    def require(key: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(path, key, files.shown(fields[key]), expected)

    name, mesh, category, camera = fields["name"], fields["mesh"], fields["category"], fields["camera"]
    require(
        "name",
        isinstance(name, str) and files.is_plain_name(name),
        "a text that can name a folder: printable, no slash, at most 200 bytes",
    )
    require("category", isinstance(category, str) and category != "" and category.isprintable(), "a printable text")
    require("side", fields["side"] in ("left", "right"), '"left" or "right"')
    plausible = _is_number(fields["fps"]) and SLOWEST <= fields["fps"] <= FASTEST
    require("fps", plausible, f"frames per second, {SLOWEST:g} to {FASTEST:g}")
    require("mesh", isinstance(mesh, str) and mesh != "", "the name of a mesh file")
    require("scale", fields["scale"] in ("known", "free"), '"known" or "free"')
    require("provenance", isinstance(fields.setdefault("provenance", {}), dict), "an object")
    require("camera", isinstance(camera, dict) and "K" in camera, '{"K": 3x3} or {"K": [3x3, ...]}')
    _known(path, "camera.", camera, CAMERA_KEYS[version], version)
    return cast(ClipFields, fields | {"provenance": parse(path, fields["provenance"], version)})


def _known(path: Path, where: str, stored: dict[str, object], known: tuple[str, ...], version: int) -> None:
    """Raise ``InputError`` for a key that a version does not have."""
    unknown = next((key for key in stored if key not in known), None)
    if unknown is not None:
        expected = f"one of {', '.join(known)} (version {version})"
        raise InputError(path, f"{where}{files.plain(unknown)}", "an unknown key", expected)


def _is_number(value: object) -> bool:
    """Return whether a JSON value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and math.isfinite(value)


def _size(path: Path, size: object) -> tuple[int, int]:
    """Width and height [px]."""
    sides = size if isinstance(size, list) else []
    if len(sides) != 2 or not all(type(side) is int and 0 < side <= LARGEST_SIDE for side in sides):
        expected = f"[width, height] in whole pixels, 1 to {LARGEST_SIDE} each"
        raise InputError(path, "size", files.shown(size), expected)
    if sides[0] * sides[1] > LARGEST_IMAGE:
        raise InputError(path, "size", files.shown(size), f"at most {LARGEST_IMAGE / 1e6:g} million pixels")
    return sides[0], sides[1]
