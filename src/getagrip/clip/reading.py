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
from getagrip.clip.per_frame import CLIP_CAMERA_KEYS, parse_frame_names, parse_intrinsics, parse_times, parse_world
from getagrip.clip.plausible import MAX_FPS, MIN_FPS, check_in_view
from getagrip.clip.reading_arrays import (
    EXPECTED_HAND_FILE,
    OTHER_HAND_FILE,
    frames_with_hand,
    read_hand,
    read_other_hand,
    read_truth,
)
from getagrip.clip.timeline import Side, at_frames, read_segments
from getagrip.errors import InputError
from getagrip.geometry.mesh_files import read_mesh
from getagrip.io import files
from getagrip.io.named import check_arguments
from getagrip.provenance import Provenance, parse_provenance

CLIP_FORMAT_VERSION = 4
"""Version of the clips that are written; older ones are read, too."""
REQUIRED_CLIP_KEYS = ("version", "name", "category", "side", "fps", "frames", "size", "camera", "mesh", "scale")
OPTIONAL_KEYS_BY_VERSION = {1: ("provenance",), 2: ("provenance", "times"), 3: ("provenance", "times", "segments")}
OPTIONAL_KEYS_BY_VERSION[4] = (*OPTIONAL_KEYS_BY_VERSION[3], "depth")
"""Further keys of ``clip.json`` by its version."""
CAMERA_KEYS_BY_VERSION = {1: CLIP_CAMERA_KEYS[:1], 2: CLIP_CAMERA_KEYS[:3], 3: CLIP_CAMERA_KEYS, 4: CLIP_CAMERA_KEYS}
"""Keys of ``camera`` by the version; only the first must be there."""
MAX_CLIP_SIDE_PX, MAX_CLIP_IMAGE_PIXELS = 16384, 40_000_000
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


@check_arguments
def read_clip(folder: str | Path) -> Clip:
    """Read and check a clip, except its masks and images, in the frames that have a hand.

    Args:
        folder: the clip's folder, or the ``clip.json`` in it (docs/formats.md).

    Raises:
        InputError: a file is missing, damaged or impossible. The message names the file and the key.
    """
    folder = _resolve_clip_folder(folder)
    path = folder / "clip.json"
    fields = _read_clip_fields(folder)
    frames = parse_frame_names(path, fields["frames"])
    size = _parse_image_size(path, fields["size"])
    mesh = read_mesh(_mesh_path(folder, fields))
    hand_path = files.inside(folder, "hand.npz", "", EXPECTED_HAND_FILE)
    rows = frames_with_hand(hand_path, frames)
    hand = read_hand(hand_path, len(rows))
    K = parse_intrinsics(path, fields["camera"], len(frames), size)[rows]
    when = parse_times(path, fields["times"], frames)[rows] if "times" in fields else None
    if when is None and len(rows) < len(frames):
        when = rows / float(fields["fps"])
    where = parse_world(path, fields["camera"], frames)
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
        return {**self.fields, **new, "version": CLIP_FORMAT_VERSION}


def read_header(folder: str | Path) -> ClipHeader:
    """Read the header of a clip, which may lack its hands yet. Raises ``InputError``."""
    folder = _resolve_clip_folder(folder)
    fields, path = _read_clip_fields(folder), folder / "clip.json"
    frames, size = parse_frame_names(path, fields["frames"]), _parse_image_size(path, fields["size"])
    if "times" in fields:
        parse_times(path, fields["times"], frames)
    where = parse_world(path, fields["camera"], frames)
    read_segments(path, fields.get("segments", []), frames, where is not None)
    return ClipHeader(folder, fields, frames, size, parse_intrinsics(path, fields["camera"], len(frames), size))


def read_name(folder: str | Path) -> str:
    """Read the name of a clip, and check its ``clip.json`` and nothing else. Raises ``InputError``."""
    return _read_clip_fields(_resolve_clip_folder(folder))["name"]


def input_sha256(folder: str | Path) -> str:
    """Compute the checksum of a reconstruction's inputs: ``clip.json``, hands, mesh, evidence; not images, not truth.

    Raises ``InputError`` where one of them is missing.
    """
    folder = _resolve_clip_folder(folder)
    fields = _read_clip_fields(folder)
    hand = files.inside(folder, "hand.npz", "", EXPECTED_HAND_FILE)
    frames = parse_frame_names(folder / "clip.json", fields["frames"])
    paths = {"clip.json": folder / "clip.json", "hand.npz": hand, fields["mesh"]: _mesh_path(folder, fields)}
    if (folder / OTHER_HAND_FILE).exists():
        paths[OTHER_HAND_FILE] = files.inside(folder, OTHER_HAND_FILE, "", EXPECTED_HAND_FILE)
    with_hand = [frames[row] for row in frames_with_hand(hand, frames)]
    for name in (name for modality in modalities() for name in modality.files(folder, with_hand)):
        paths[name] = files.inside(folder, name, "", "evidence for each frame of clip.json")
    return files.sha256(paths)


def _resolve_clip_folder(path: str | Path) -> Path:
    path = Path(path)
    return path.parent if path.name == "clip.json" else path


def _mesh_path(folder: Path, fields: ClipFields) -> Path:
    return files.inside(folder, fields["mesh"], "mesh", "a triangle mesh", source=folder / "clip.json")


def _read_clip_fields(folder: Path) -> ClipFields:
    """Read the fields of ``clip.json``: none missing or unknown, those of one text or number checked."""
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "the folder of a clip")
    path = files.inside(folder, "clip.json", "", "the description of a clip")
    fields = files.read_json(path)
    version = fields.get("version", CLIP_FORMAT_VERSION)
    if type(version) is not int or version not in OPTIONAL_KEYS_BY_VERSION:
        raise InputError(path, "version", files.shorten_value(version), " or ".join(map(str, OPTIONAL_KEYS_BY_VERSION)))
    _check_known_keys(path, "", fields, (*REQUIRED_CLIP_KEYS, *OPTIONAL_KEYS_BY_VERSION[version]), version)
    missing = next((key for key in REQUIRED_CLIP_KEYS if key not in fields), None)
    if missing is not None:
        raise InputError(path, missing, "no such key", "the key")

    def require(key: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(path, key, files.shorten_value(fields[key]), expected)

    name, mesh, category, camera = fields["name"], fields["mesh"], fields["category"], fields["camera"]
    require(
        "name",
        isinstance(name, str) and files.is_portable_name(name),
        "a text that can name a folder: printable, no slash, at most 200 bytes",
    )
    require("category", isinstance(category, str) and category != "" and category.isprintable(), "a printable text")
    require("side", fields["side"] in ("left", "right"), '"left" or "right"')
    plausible = _is_float_number(fields["fps"]) and MIN_FPS <= fields["fps"] <= MAX_FPS
    require("fps", plausible, f"frames per second, {MIN_FPS:g} to {MAX_FPS:g}")
    require("mesh", isinstance(mesh, str) and mesh != "", "the name of a mesh file")
    require("scale", fields["scale"] in ("known", "free"), '"known" or "free"')
    require("provenance", isinstance(fields.setdefault("provenance", {}), dict), "an object")
    require("camera", isinstance(camera, dict) and "K" in camera, '{"K": 3x3} or {"K": [3x3, ...]}')
    _check_known_keys(path, "camera.", camera, CAMERA_KEYS_BY_VERSION[version], version)
    return cast(ClipFields, fields | {"provenance": parse_provenance(path, fields["provenance"], version)})


def _check_known_keys(path: Path, where: str, stored: dict[str, object], known: tuple[str, ...], version: int) -> None:
    """Raise ``InputError`` for a key that a version does not have."""
    unknown = next((key for key in stored if key not in known), None)
    if unknown is not None:
        expected = f"one of {', '.join(known)} (version {version})"
        raise InputError(path, f"{where}{files.printable(unknown)}", "an unknown key", expected)


def _is_float_number(value: object) -> bool:
    """Return whether a JSON value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and math.isfinite(value)


def _parse_image_size(path: Path, size: object) -> tuple[int, int]:
    """Width and height [px]."""
    sides = size if isinstance(size, list) else []
    if len(sides) != 2 or not all(type(side) is int and 0 < side <= MAX_CLIP_SIDE_PX for side in sides):
        expected = f"[width, height] in whole pixels, 1 to {MAX_CLIP_SIDE_PX} each"
        raise InputError(path, "size", files.shorten_value(size), expected)
    if sides[0] * sides[1] > MAX_CLIP_IMAGE_PIXELS:
        raise InputError(
            path, "size", files.shorten_value(size), f"at most {MAX_CLIP_IMAGE_PIXELS / 1e6:g} million pixels"
        )
    return sides[0], sides[1]
