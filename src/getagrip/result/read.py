"""Read the folder of a result (docs/formats.md), which is untrusted: every value is checked."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, check_arguments
from getagrip.geometry import se3
from getagrip.geometry.profile import N_PROFILE_RADII, Profile
from getagrip.geometry.warp import N_MONOMIALS, Warp
from getagrip.io import arrays, files
from getagrip.io.files import Json
from getagrip.result.findings import read_checks, read_findings, read_probability
from getagrip.result.result import (
    MAX_RESULT_DISTANCE_M,
    Axis,
    Candidates,
    FrameKind,
    Reconstruction,
    Status,
    read_segments,
)
from getagrip.result.write import AXIS_ARRAYS, PROFILE_ARRAYS, RESULT_VERSION, WARP_ARRAYS

MIN_MESH_SCALE, MAX_MESH_SCALE = 1e-15, 1e4
"""Bounds of a mesh's scale; a free scale may end near 0."""
MAX_WARP_COEFFICIENT = 10.0
"""Maximum coefficient of a warp; plausible ones are about 0 or 1."""
RESULT_ARRAYS = (
    "T_hand_obj", "T_cam_hand", "T_cam_other_hand", "scale", "frames", "frame_kind", "iou", *AXIS_ARRAYS,
    "candidate_T_hand_obj", "candidate_scale", "candidate_energy", "hand_scale", "hand_covariance", "hand_alternatives",
    *WARP_ARRAYS, *PROFILE_ARRAYS,
)  # fmt: skip
"""Arrays of ``result.npz``."""
RESULT_DEFAULTS: Json = {
    "ambiguous": False, "message": "", "notes": [], "assumptions": {}, "findings": [], "checks": {}, "signs": {},
    "probability_right": None, "probability_right_in_camera": None, "segments": [], "hand_energy": {},
    "distance_interval_mm": None, "probability_looks_right": None,
}  # fmt: skip
"""Optional keys of ``result.json``, and their defaults."""
RESULT_FIELDS: dict[str, tuple[type, str]] = {
    "clip": (str, "the clip's name"),
    "method": (str, "the method's name"),
    "options": (dict, "an object"),
    "seed": (int, "a whole number"),
    "status": (str, "a word"),
    "message": (str, "a text"),
    "ambiguous": (bool, "true or false"),
    "notes": (list, "a list of texts"),
    "assumptions": (dict, "texts by topic"),
    "findings": (list, "a list of findings"),
    "checks": (dict, "numbers by name"),
    "signs": (dict, "numbers by name"),
    "energy": (dict, "numbers by name"),
    "hand_energy": (dict, "pairs of numbers by name"),
    "metrics": (dict, "numbers by name"),
    "seconds": (dict, "numbers by name"),
    "segments": (list, "a list of segments"),
    "software": (dict, "an object"),
    "input_sha256": (str, "a checksum"),
}
"""Keys of ``result.json``: type, and description in errors."""


@check_arguments
def read_result(folder: str | Path) -> tuple[Reconstruction, Json]:
    """Read and check a result folder.

    Args:
        folder: the folder, as ``write_result`` or ``getagrip reconstruct`` made it.

    Returns:
        The reconstruction, and the content of its ``result.json``.

    Raises:
        InputError: a file is missing, damaged or impossible.
    """
    folder = Path(folder)
    fields = read_result_record(folder)
    path, record = files.inside(folder, "result.npz", "", "the poses of a result"), folder / "result.json"
    stored = arrays.read(path, lambda key: key in RESULT_ARRAYS)
    frames = _read_frame_names(path, stored, "frames")
    T = len(frames)
    if len({*frames}) < T:
        twice = next(name for name in frames if frames.count(name) > 1)
        raise InputError(path, "frames", f"{files.shorten_value(twice)} twice", "each frame once")
    kind = _read_frame_kind(path, stored, T)
    K = len(stored.get("candidate_energy", [])) if np.ndim(stored.get("candidate_energy", 0)) else 1
    axis = None
    if any(key in stored for key in AXIS_ARRAYS):
        direction = arrays.floats(path, stored, "axis_direction", (3,))
        if abs(np.linalg.norm(direction) - 1.0) > 1e-3:
            raise InputError(path, "axis_direction", f"length {np.linalg.norm(direction):.4g}", "a unit vector")
        point = _read_point(path, stored, "axis_point")
        axis = Axis(point=point, direction=direction, angle=arrays.floats(path, stored, "angle", (T,)))
    result = Reconstruction(
        clip=fields["clip"],
        method=fields["method"],
        frames=frames,
        frame_kind=kind,
        T_hand_obj=_read_rigid(path, stored, "T_hand_obj", (T, 4, 4)),
        scale=float(_read_scales(path, stored, "scale", ())),
        iou=_read_iou(path, stored, kind),
        axis=axis,
        candidates=Candidates(
            T_hand_obj=_read_rigid(path, stored, "candidate_T_hand_obj", (K, T, 4, 4)),
            scale=_read_scales(path, stored, "candidate_scale", (K,)),
            energy=arrays.floats(path, stored, "candidate_energy", (K,)),
        ),
        energy=read_checks(record, fields["energy"], "energy"),
        status=Status(fields["status"]),
        message=fields["message"],
        ambiguous=fields["ambiguous"],
        seconds=read_checks(record, fields["seconds"], "seconds"),
        options=fields["options"],
        seed=fields["seed"],
        notes=tuple(fields["notes"]),
        assumptions=fields["assumptions"],
        findings=read_findings(record, fields["findings"]),
        checks=read_checks(record, fields["checks"]),
        signs=read_checks(record, fields["signs"], "signs"),
        probability_right=read_probability(record, fields["probability_right"]),
        probability_right_in_camera=read_probability(
            record, fields["probability_right_in_camera"], "probability_right_in_camera"
        ),
        probability_looks_right=read_probability(record, fields["probability_looks_right"], "probability_looks_right"),
        distance_interval_mm=_read_distance_interval(record, fields["distance_interval_mm"]),
        T_cam_hand=_read_hand_poses(path, stored, "T_cam_hand", T),
        hand_scale=float(_read_scales(path, stored, "hand_scale", ())) if "hand_scale" in stored else 1.0,
        hand_alternatives=_read_hand_alternatives(path, stored),
        hand_covariance=arrays.floats(path, stored, "hand_covariance", (6, 6)) if "hand_covariance" in stored else None,
        hand_energy=_read_hand_energy(record, fields["hand_energy"]),
        T_cam_other_hand=_read_hand_poses(path, stored, "T_cam_other_hand", T),
        warp=_read_warp(path, stored) if any(key in stored for key in WARP_ARRAYS) else None,
        segments=read_segments(record, fields["segments"]),
    )
    return result, fields


def read_result_record(folder: str | Path) -> Json:
    """Read and check a result's ``result.json``. Raises ``InputError``."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "the folder of a result")
    path = files.inside(folder, "result.json", "", "the record of a result")
    fields = files.read_json(path)
    version = fields.get("version")
    if type(version) is not int or not 1 <= version <= RESULT_VERSION:
        raise InputError(path, "version", files.shorten_value(version), f"1 to {RESULT_VERSION}")
    fields = RESULT_DEFAULTS | fields
    for key, (kind, expected) in RESULT_FIELDS.items():
        if key not in fields:
            raise InputError(path, key, "no such key", expected)
        if not isinstance(fields[key], kind):
            raise InputError(path, key, files.shorten_value(fields[key]), expected)
    _check_texts(path, {f"notes[{n}]": note for n, note in enumerate(fields["notes"])})
    if version == 1:
        fields |= _convert_version_1(fields)
    words = [status.value for status in Status]
    if fields["status"] not in words:
        raise InputError(path, "status", files.shorten_value(fields["status"]), ", ".join(words))
    _check_texts(path, {f"assumptions.{files.printable(topic)}": text for topic, text in fields["assumptions"].items()})
    for key in ("energy", "metrics", "seconds"):
        read_checks(path, fields[key], key)
    if not files.is_portable_name(fields["clip"]):
        raise InputError(path, "clip", files.shorten_value(fields["clip"]), "a text fit to name a folder")
    return fields


def _read_hand_energy(path: Path, entry: Json) -> dict[str, tuple[float, float]]:
    """Read the energy of each kind of evidence on the hand, before and after the fit."""
    pairs: dict[str, tuple[float, float]] = {}
    for name, pair in entry.items():
        key = f"hand_energy.{files.printable(name)}"
        if not isinstance(pair, list) or len(pair) != 2:
            raise InputError(path, key, files.shorten_value(pair), "two numbers, before and after")
        before, after = read_checks(path, dict(zip(("before", "after"), pair, strict=True)), key).values()
        pairs[name] = before, after
    return pairs


def _read_distance_interval(path: Path, value: object) -> tuple[float, float] | None:
    """Read two rising distances [mm]; None for null."""
    if value is None:
        return None
    key, most = "distance_interval_mm", 1e3 * MAX_RESULT_DISTANCE_M
    pair = value if isinstance(value, list) and len(value) == 2 else [None, None]
    low, high = read_checks(path, dict(zip(("low", "high"), pair, strict=True)), key).values()
    if not 0.0 <= low <= high <= most:
        raise InputError(path, key, files.shorten_value(value), f"null, or two rising numbers from 0 to {most:g} [mm]")
    return low, high


def _check_texts(path: Path, stored: dict[str, object]) -> None:
    """Raise ``InputError`` for a value that is not a text."""
    for key, value in stored.items():
        if not isinstance(value, str):
            raise InputError(path, key, files.shorten_value(value), "a text")


def _convert_version_1(fields: Json) -> Json:
    """Convert the fields of version 1, with the status as a sentence, and assumptions among the notes."""
    guesses = {f"note {n}": note for n, note in enumerate(fields["notes"], start=1) if "guess" in note.lower()}
    status = Status.of_sentence(fields["status"])
    return {"status": status.value, "message": fields["status"], "assumptions": guesses}


def _read_frame_names(path: Path, arrays: dict[str, ndarray], key: str) -> tuple[str, ...]:
    """Read an array of names."""
    if key not in arrays or arrays[key].dtype.kind != "U" or arrays[key].ndim != 1 or len(arrays[key]) == 0:
        raise InputError(path, key, "no array of names", "the frames' names")
    try:
        return tuple(str(text) for text in arrays[key])
    except ValueError as error:  # invalid code points
        raise InputError(path, key, "a damaged text", "the frames' names") from error


def _read_frame_kind(path: Path, arrays: dict[str, ndarray], frames: int) -> tuple[FrameKind, ...]:
    """Read the kind of each frame's pose; in older results, all frames were sampled."""
    if "frame_kind" not in arrays:
        return tuple("sampled" for _ in range(frames))
    kinds: dict[str, FrameKind] = {kind: kind for kind in get_args(FrameKind)}
    texts = _read_frame_names(path, arrays, "frame_kind")
    if len(texts) != frames or not {*texts} <= {*kinds}:
        got = f"{len(texts)} texts, {files.shorten_value(' '.join(sorted({*texts}))[:80])}"
        raise InputError(path, "frame_kind", got, f"{', '.join(kinds)} for each of {frames} frames")
    return tuple(kinds[text] for text in texts)


def _read_iou(path: Path, stored: dict[str, ndarray], kind: tuple[FrameKind, ...]) -> Float[ndarray, "T"]:
    """Read the IOU of each frame; NaN only for interpolated ones."""
    if "iou" in stored and stored["iou"].dtype.kind == "f" and stored["iou"].shape == (len(kind),):
        unknown = np.isnan(stored["iou"]) & (np.array(kind) == "interpolated")
        known = arrays.floats(path, stored | {"iou": np.where(unknown, 0.0, stored["iou"])}, "iou", (len(kind),))
        return np.where(unknown, np.nan, _check_range(path, "iou", known, 0.0, 1.0))
    return _check_range(path, "iou", arrays.floats(path, stored, "iou", (len(kind),)), 0.0, 1.0)


def _read_rigid(
    path: Path, stored: dict[str, ndarray], key: str, shape: tuple[int, ...]
) -> Float[ndarray, "*batch 4 4"]:
    """Read an array of rigid motions."""
    T = arrays.floats(path, stored, key, shape)
    if not se3.is_rigid(T).all():
        raise InputError(path, key, "a matrix that is no rigid motion", "rotations and translations [m]")
    _check_range(path, key, T[..., :3, 3], -MAX_RESULT_DISTANCE_M, MAX_RESULT_DISTANCE_M)
    return T


def _read_hand_poses(path: Path, stored: dict[str, ndarray], key: str, frames: int) -> Float[ndarray, "T 4 4"] | None:
    return _read_rigid(path, stored, key, (frames, 4, 4)) if key in stored else None


def _read_hand_alternatives(path: Path, stored: dict[str, ndarray]) -> Float[ndarray, "M 4 4"] | None:
    """Read the alternative hand poses."""
    key = "hand_alternatives"
    return _read_rigid(path, stored, key, (len(np.atleast_1d(stored[key])), 4, 4)) if key in stored else None


def _read_warp(path: Path, stored: dict[str, ndarray]) -> Warp:
    """Read the deformation of the mesh."""
    centre, radius, factors = WARP_ARRAYS
    coefficients = arrays.floats(path, stored, factors, (N_MONOMIALS, 3))
    _check_range(path, factors, coefficients, -MAX_WARP_COEFFICIENT, MAX_WARP_COEFFICIENT)
    profile = _read_profile(path, stored) if any(key in stored for key in PROFILE_ARRAYS) else None
    return Warp(_read_point(path, stored, centre), float(_read_scales(path, stored, radius, ())), coefficients, profile)


def _read_profile(path: Path, stored: dict[str, ndarray]) -> Profile:
    """Read the radii of a body of revolution, before and after the fit."""
    axis, ends, before, after = PROFILE_ARRAYS
    places = [
        _check_range(path, key, arrays.floats(path, stored, key, (2,)), -MAX_RESULT_DISTANCE_M, MAX_RESULT_DISTANCE_M)
        for key in (axis, ends)
    ]
    if not places[1][0] < places[1][1]:
        raise InputError(path, ends, files.shorten_value(places[1].tolist()), "the lower end, then the upper one [m]")
    radii = (_read_scales(path, stored, key, (N_PROFILE_RADII,)) for key in (before, after))
    return Profile(*places, *radii)


def _read_point(path: Path, stored: dict[str, ndarray], key: str) -> Float[ndarray, "3"]:
    point = arrays.floats(path, stored, key, (3,))
    return _check_range(path, key, point, -MAX_RESULT_DISTANCE_M, MAX_RESULT_DISTANCE_M)


def _read_scales(path: Path, stored: dict[str, ndarray], key: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    return _check_range(path, key, arrays.floats(path, stored, key, shape, kinds="fiu"), MIN_MESH_SCALE, MAX_MESH_SCALE)


def _check_range(
    path: Path, key: str, values: Float[ndarray, "..."], least: float, most: float
) -> Float[ndarray, "..."]:
    """Return values between ``least`` and ``most``. Raises ``InputError`` for others."""
    for value in (values.min(), values.max()):
        if not least <= value <= most:
            raise InputError(path, key, f"{value:g}", f"{least:g} to {most:g}")
    return values
