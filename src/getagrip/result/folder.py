"""The folder of a reconstruction (docs/formats.md)."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.finding import read_checks, read_findings
from getagrip.geometry import se3
from getagrip.geometry.warp import MONOMIALS, Warp
from getagrip.io import arrays, code, files
from getagrip.probability import read_probability
from getagrip.result.data import Axis, Candidates, FrameKind, Reconstruction

VERSION = 1
FILES = ("result.json", "result.npz")
"""Of a result's folder."""
MOST_WARPED = 10.0
"""Coefficients of a warp are about 1 or 0; far more would be no shape of a mesh."""
AXIS = ("axis_point", "axis_direction", "angle")
WARP = ("warp_centre", "warp_radius", "warp_coefficients")
ARRAYS = (
    "T_hand_obj", "T_cam_hand", "T_cam_other_hand", "scale", "frames", "frame_kind", "iou", *AXIS,
    "candidate_T_hand_obj", "candidate_scale", "candidate_energy", *WARP,
)  # fmt: skip
"""What ``result.npz`` holds."""
FIELDS: dict[str, tuple[type, str]] = {
    "clip": (str, "the clip's name"),
    "method": (str, "the method's name"),
    "options": (dict, "an object"),
    "seed": (int, "a whole number"),
    "status": (str, "a text"),
    "ambiguous": (bool, "true or false"),
    "notes": (list, "a list of texts"),
    "findings": (list, "a list of findings"),
    "checks": (dict, "numbers by name"),
    "signs": (dict, "numbers by name"),
    "energy": (dict, "an object"),
    "metrics": (dict, "an object"),
    "seconds": (dict, "an object"),
    "segments": (list, "a list of segments"),
    "software": (dict, "an object"),
    "input_sha256": (str, "a checksum"),
}
"""Keys of ``result.json``, each with its type."""


def read_result(folder: str | Path) -> tuple[Reconstruction, dict[str, Any]]:
    """Read and check a result folder: the reconstruction, and ``result.json`` as it stands. Raises ``InputError``."""
    folder = Path(folder)
    fields = read_record(folder)
    path = files.inside(folder, "result.npz", "", "the poses of a result")
    given = arrays.read(path, lambda key: key in ARRAYS)
    frames = _texts(path, given, "frames")
    T = len(frames)
    kind = _frame_kind(path, given, T)
    K = len(given.get("candidate_energy", [])) if np.ndim(given.get("candidate_energy", 0)) else 1
    axis = None
    if any(key in given for key in AXIS):
        direction = arrays.floats(path, given, "axis_direction", (3,))
        if abs(np.linalg.norm(direction) - 1.0) > 1e-3:
            raise InputError(path, "axis_direction", f"length {np.linalg.norm(direction):.4g}", "a unit vector")
        point = arrays.floats(path, given, "axis_point", (3,))
        axis = Axis(point=point, direction=direction, angle=arrays.floats(path, given, "angle", (T,)))
    result = Reconstruction(
        clip=fields["clip"],
        method=fields["method"],
        frames=frames,
        frame_kind=kind,
        T_hand_obj=_rigid(path, given, "T_hand_obj", (T, 4, 4)),
        scale=float(_above_zero(path, given, "scale", ())),
        iou=_iou(path, given, kind),
        axis=axis,
        candidates=Candidates(
            T_hand_obj=_rigid(path, given, "candidate_T_hand_obj", (K, T, 4, 4)),
            scale=_above_zero(path, given, "candidate_scale", (K,)),
            energy=arrays.floats(path, given, "candidate_energy", (K,)),
        ),
        energy=fields["energy"],
        status=fields["status"],
        ambiguous=fields["ambiguous"],
        seconds=fields["seconds"],
        options=fields["options"],
        seed=fields["seed"],
        notes=tuple(fields["notes"]),
        findings=read_findings(folder / "result.json", fields["findings"]),
        checks=read_checks(folder / "result.json", fields["checks"]),
        signs=read_checks(folder / "result.json", fields["signs"], "signs"),
        probability_right=read_probability(folder / "result.json", fields["probability_right"]),
        probability_right_in_camera=read_probability(
            folder / "result.json", fields["probability_right_in_camera"], "probability_right_in_camera"
        ),
        T_cam_hand=_rigid(path, given, "T_cam_hand", (T, 4, 4)) if "T_cam_hand" in given else None,
        T_cam_other_hand=_rigid(path, given, "T_cam_other_hand", (T, 4, 4)) if "T_cam_other_hand" in given else None,
        warp=_warp(path, given) if any(key in given for key in WARP) else None,
        segments=_segments(folder / "result.json", fields["segments"]),
    )
    return result, fields


def read_record(folder: str | Path) -> dict[str, Any]:
    """The checked content of a result's ``result.json``. Raises ``InputError``."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", "the folder of a result")
    path = files.inside(folder, "result.json", "", "the record of a result")
    fields = files.read_json(path)
    if fields.get("version") != VERSION:
        raise InputError(path, "version", files.shown(fields.get("version")), str(VERSION))
    fields.setdefault("ambiguous", False)
    fields.setdefault("notes", [])
    fields.setdefault("findings", [])
    fields.setdefault("checks", {})
    fields.setdefault("signs", {})
    fields.setdefault("probability_right", None)
    fields.setdefault("probability_right_in_camera", None)
    fields.setdefault("segments", [])
    for key, (kind, expected) in FIELDS.items():
        if key not in fields:
            raise InputError(path, key, "no such key", expected)
        if not isinstance(fields[key], kind):
            raise InputError(path, key, files.shown(fields[key]), expected)
    if not files.is_plain_name(fields["clip"]):
        raise InputError(path, "clip", files.shown(fields["clip"]), "a text fit to name a folder")
    return fields


def write_result(
    result: Reconstruction,
    folder: str | Path,
    input_sha256: str = "",
    metrics: dict[str, Any] | None = None,
    clip_folder: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a result folder, complete or not at all, and return it.

    ``input_sha256`` is the checksum of the clip's files (``clip.input_sha256``), if it has any: ``getagrip evaluate``
    takes no other clip for it. ``clip_folder`` is where that command looks for the clip. With ``overwrite`` an older
    result in ``folder`` is replaced. Raises ``UsageError`` where the folder exists otherwise.
    """
    folder = Path(folder)
    with files.new_folder(folder, FILES if overwrite else ()) as new:
        arrays.write(new / "result.npz", _arrays(result))
        files.write_json(new / "result.json", _fields(result, input_sha256, metrics, clip_folder))
    return folder


def is_result(folder: Path) -> bool:
    """Whether a folder is a result's, and thus ours to replace."""
    return all((folder / name).is_file() for name in FILES)


def _arrays(result: Reconstruction) -> dict[str, Shaped[ndarray, "..."]]:
    """What ``result.npz`` holds."""
    out: dict[str, ndarray] = {
        "T_hand_obj": result.T_hand_obj,
        "scale": np.array(result.scale, dtype=float),
        "frames": np.array(result.frames, dtype=np.str_),
        "frame_kind": np.array(result.frame_kind, dtype=np.str_),
        "iou": result.iou,
        "candidate_T_hand_obj": result.candidates.T_hand_obj,
        "candidate_scale": result.candidates.scale,
        "candidate_energy": result.candidates.energy,
    }
    if result.T_cam_hand is not None:
        out["T_cam_hand"] = result.T_cam_hand
    if result.T_cam_other_hand is not None:
        out["T_cam_other_hand"] = result.T_cam_other_hand
    if result.warp is not None:
        warp = result.warp
        out |= dict(zip(WARP, (warp.centre, np.array(warp.radius), warp.coefficients), strict=True))
    if result.axis is not None:
        axis = result.axis
        out |= {"axis_point": axis.point, "axis_direction": axis.direction, "angle": axis.angle}
    return out


def _fields(
    result: Reconstruction, input_sha256: str, metrics: dict[str, Any] | None, clip_folder: str | Path | None
) -> dict[str, Any]:
    """What ``result.json`` says."""
    return {
        "version": VERSION,
        "clip": result.clip,
        "clip_folder": None if clip_folder is None else _resolved(str(clip_folder)),
        "method": result.method,
        "options": result.options,
        "seed": result.seed,
        "status": result.status,
        "ambiguous": result.ambiguous,
        "notes": result.notes,
        "findings": [finding.fields() for finding in result.findings],
        "checks": result.checks,
        "signs": result.signs,
        "probability_right": result.probability_right and result.probability_right.fields(),
        "probability_right_in_camera": result.probability_right_in_camera
        and result.probability_right_in_camera.fields(),
        "energy": result.energy,
        "metrics": metrics or {},
        "seconds": result.seconds,
        **({"segments": result.segments} if result.segments else {}),
        "software": software(),
        "input_sha256": input_sha256,
    }


def _resolved(folder: str) -> str:
    """An absolute path; an address in an object store stays as it is."""
    return folder if "://" in folder else str(Path(folder).resolve())


def software() -> dict[str, str]:
    """Versions of the package, of Python, and of the libraries that the numbers depend on; and which code it is."""
    packages = ("getagrip", "numpy", "scipy", "numba", "trimesh", "opencv-python-headless")
    versions = {package: metadata.version(package) for package in packages}
    return {"python": platform.python_version(), **versions, "code": code.fingerprint()}


def _segments(path: Path, given: list[Any]) -> tuple[dict[str, Any], ...]:
    """What a timeline's result says of its segments: each an object with a state and its frames."""
    for n, segment in enumerate(given):
        if not isinstance(segment, dict) or not all(
            isinstance(segment.get(k), str) for k in ("state", "first", "last")
        ):
            raise InputError(path, f"segments[{n}]", files.shown(segment), "an object with state, first and last")
        read_probability(path, segment.get("probability_right"))
    return tuple(given)


def _texts(path: Path, given: dict[str, ndarray], key: str) -> tuple[str, ...]:
    """An array of names."""
    if key not in given or given[key].dtype.kind != "U" or given[key].ndim != 1 or len(given[key]) == 0:
        raise InputError(path, key, "no array of names", "the frames' names")
    try:
        return tuple(str(text) for text in given[key])
    except ValueError as error:  # code points that do not exist
        raise InputError(path, key, "a damaged text", "the frames' names") from error


def _frame_kind(path: Path, given: dict[str, ndarray], frames: int) -> tuple[FrameKind, ...]:
    """How each frame's pose was found; in older results, all frames were sampled."""
    if "frame_kind" not in given:
        return tuple("sampled" for _ in range(frames))
    kinds: dict[str, FrameKind] = {kind: kind for kind in get_args(FrameKind)}
    texts = _texts(path, given, "frame_kind")
    if len(texts) != frames or not {*texts} <= {*kinds}:
        given_texts = f"{len(texts)} texts, {files.shown(' '.join(sorted({*texts}))[:80])}"
        raise InputError(path, "frame_kind", given_texts, f"{', '.join(kinds)} for each of {frames} frames")
    return tuple(kinds[text] for text in texts)


def _iou(path: Path, given: dict[str, ndarray], kind: tuple[FrameKind, ...]) -> Float[ndarray, "T"]:
    """The IOU of each frame; only interpolated ones may have none."""
    if "iou" in given and given["iou"].dtype.kind == "f" and given["iou"].shape == (len(kind),):
        unknown = np.isnan(given["iou"]) & (np.array(kind) == "interpolated")
        known = arrays.floats(path, given | {"iou": np.where(unknown, 0.0, given["iou"])}, "iou", (len(kind),))
        return np.where(unknown, np.nan, known)
    return arrays.floats(path, given, "iou", (len(kind),))


def _rigid(path: Path, given: dict[str, ndarray], key: str, shape: tuple[int, ...]) -> Float[ndarray, "*batch 4 4"]:
    """An array of rigid motions."""
    T = arrays.floats(path, given, key, shape)
    if not se3.is_rigid(T).all():
        raise InputError(path, key, "a matrix that is no rigid motion", "rotations and translations [m]")
    return T


def _warp(path: Path, given: dict[str, ndarray]) -> Warp:
    """What the mesh was made into."""
    centre, radius, factors = WARP
    coefficients = arrays.floats(path, given, factors, (MONOMIALS, 3))
    if np.abs(coefficients).max() > MOST_WARPED:
        raise InputError(path, factors, f"{np.abs(coefficients).max():g}", f"at most {MOST_WARPED:g}")
    return Warp(arrays.floats(path, given, centre, (3,)), float(_above_zero(path, given, radius, ())), coefficients)


def _above_zero(path: Path, given: dict[str, ndarray], key: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """An array of scales."""
    scale = arrays.floats(path, given, key, shape, kinds="fiu")
    if scale.min() <= 0:
        raise InputError(path, key, f"{scale.min():g}", "numbers above 0")
    return scale
