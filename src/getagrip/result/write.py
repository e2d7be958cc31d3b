"""Write the folder of a result (docs/formats.md)."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray

from getagrip.errors import check_arguments, replace_surrogates
from getagrip.io import arrays, files, plugins
from getagrip.result.result import Reconstruction

RESULT_VERSION = 3
"""Version of written results; older ones can be read."""
RESULT_FILES = ("result.json", "result.npz")
"""Files of a result's folder."""
AXIS_ARRAYS = ("axis_point", "axis_direction", "angle")
WARP_ARRAYS = ("warp_centre", "warp_radius", "warp_coefficients")
PROFILE_ARRAYS = ("profile_axis", "profile_ends", "profile_before", "profile_after")
"""Arrays of ``result.npz`` that are all present or all missing."""


@check_arguments
def write_result(
    result: Reconstruction,
    folder: str | Path,
    input_sha256: str = "",
    metrics: Mapping[str, object] | None = None,
    clip_folder: str | Path | None = None,
    overwrite: bool = False,
    made_by: Mapping[str, str] | None = None,
) -> Path:
    """Write a result as a folder (docs/formats.md), completely or not at all.

    Args:
        result: the reconstruction.
        folder: the folder to make.
        input_sha256: checksum of the clip's files (``clip.input_sha256``); ``getagrip evaluate`` refuses a clip with
            another one. Empty for a clip that is only in memory.
        metrics: metrics to record in ``result.json``.
        clip_folder: the clip's folder, for ``getagrip evaluate``.
        overwrite: replace a result in ``folder``.
        made_by: names and versions of the software; None for this package.

    Returns:
        The folder.

    Raises:
        UsageError: the folder exists, and ``overwrite`` is False or it holds something other than a result.
    """
    folder, made_by = Path(folder), made_by or software_versions() | plugins.plugin_dependencies(result.method)
    with files.new_folder(folder, RESULT_FILES if overwrite else ()) as new:
        arrays.write(new / "result.npz", _result_arrays(result))
        files.write_json(new / "result.json", _result_fields(result, input_sha256, metrics, clip_folder, made_by))
    return folder


def is_result(folder: Path) -> bool:
    """Return whether a folder is a result, which may be replaced."""
    return all((folder / name).is_file() for name in RESULT_FILES)


def _result_arrays(result: Reconstruction) -> dict[str, Shaped[ndarray, "..."]]:
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
        out |= {"T_cam_hand": result.T_cam_hand, "T_cam_obj": result.T_cam_obj}
    if result.hand_scale != 1.0:
        out["hand_scale"] = np.array(result.hand_scale)
    for name in ("hand_covariance", "hand_alternatives", "T_cam_other_hand"):
        if (array := getattr(result, name)) is not None:
            out[name] = array
    if result.warp is not None:
        warp = result.warp
        out |= dict(zip(WARP_ARRAYS, (warp.centre, np.array(warp.radius), warp.coefficients), strict=True))
        if (body := warp.profile) is not None:
            out |= dict(zip(PROFILE_ARRAYS, (body.axis, body.ends, body.before, body.after), strict=True))
    if result.axis is not None:
        axis = result.axis
        out |= {"axis_point": axis.point, "axis_direction": axis.direction, "angle": axis.angle}
    return out


def _result_fields(
    result: Reconstruction,
    input_sha256: str,
    metrics: Mapping[str, object] | None,
    clip_folder: str | Path | None,
    made_by: Mapping[str, str],
) -> dict[str, object]:
    return {
        "version": RESULT_VERSION,
        "clip": result.clip,
        "clip_folder": None if clip_folder is None else _resolve_folder(str(clip_folder)),
        "method": result.method,
        "options": result.options,
        "seed": result.seed,
        "status": result.status.value,
        "message": result.message,
        "ambiguous": result.ambiguous,
        "notes": result.notes,
        "assumptions": result.assumptions,
        "findings": result.findings,
        "checks": result.checks,
        "signs": result.signs,
        "probability_right": result.probability_right,
        "probability_right_in_camera": result.probability_right_in_camera,
        **({} if (looks := result.probability_looks_right) is None else {"probability_looks_right": looks}),
        **({} if result.distance_interval_mm is None else {"distance_interval_mm": result.distance_interval_mm}),
        "energy": result.energy,
        **({"hand_energy": result.hand_energy} if result.hand_energy else {}),
        "metrics": metrics or {},
        "seconds": result.seconds,
        **({"segments": [segment.fields() for segment in result.segments]} if result.segments else {}),
        "software": made_by,
        "input_sha256": input_sha256,
    }


def _resolve_folder(folder: str) -> str:
    """Return an absolute path, as a ``file:`` address if it is not UTF-8; other addresses stay unchanged."""
    if "://" in folder:
        return folder
    whole = Path(folder).resolve()
    return str(whole) if replace_surrogates(str(whole)) == str(whole) else whole.as_uri()


def software_versions(*also: str) -> dict[str, str]:
    """Return the versions of the package, Python and the libraries, and the code's fingerprint.

    ``also`` are further parts of the package for ``plugins.fingerprint``.
    """
    packages = ("getagrip", "numpy", "scipy", "numba", "trimesh", "opencv-python-headless")
    versions = {package: metadata.version(package) for package in packages}
    return {"python": platform.python_version(), **versions, "code": plugins.fingerprint(*also)}
