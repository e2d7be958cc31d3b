"""Every number about a result: what docs/metrics.md defines, gathered."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks, input_sha256, read_clip, read_masks
from getagrip.clip.occlusion import hidden_by_hand
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io import files
from getagrip.metrics.contact import (
    SIDES,
    THRESHOLDS,
    ContactDistances,
    Side,
    contact_distances_of,
    pairwise_iou,
    stable_contact_area,
)
from getagrip.metrics.mask import MaskIou, iou_of_poses
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import Symmetries, find_symmetries
from getagrip.result import Reconstruction, read_result

IOU_THRESHOLDS = (0.8, 0.6)
"""SCA-IOU counts the clips whose mean IOU is above these (paper, Sec. 5.1)."""

Metrics = dict[str, float]
PerFrame = dict[str, Float[ndarray, "T"]]


def evaluate_result(folder: str | Path, clips: str | Path | None = None) -> dict[str, Any]:
    """All metrics of one result folder against its clip.

    ``clips`` is the folder of the clip or one that holds it under its name; without it the clip is looked for where
    ``result.json`` says and beside the result. Raises ``InputError`` where there is no such clip, where the clip is no
    longer the one that was reconstructed, and where a frame of the result is unknown to it.
    """
    result, clip, masks = read_evaluated(Path(folder), clips)
    return {"result": str(folder), **evaluate(result, clip, masks)}


def read_evaluated(folder: Path, clips: str | Path | None = None) -> tuple[Reconstruction, Clip, Masks | None]:
    """A result, and its clip and masks at the result's frames. Raises ``InputError`` as ``evaluate_result`` does."""
    result, record = read_result(folder)
    clip = clip_of(folder, result, record, clips)
    index = {name: n for n, name in enumerate(clip.frames)}
    unknown = next((name for name in result.frames if name not in index), None)
    if unknown is not None:
        known = f"frames of the clip {clip.folder}, {clip.frames[0]} to {clip.frames[-1]}"
        raise InputError(folder / "result.npz", "frames", f"the frame {files.shown(unknown)}", known)
    clip = clip.take(np.array([index[name] for name in result.frames]))
    return result, clip, read_masks(clip) if (clip.folder / "masks" / "object").exists() else None


def evaluate(result: Reconstruction, clip: Clip, masks: Masks | None) -> dict[str, Any]:
    """All metrics of a reconstruction: ``metrics`` (one number each) and ``per_frame`` (a list each).

    ``clip`` and ``masks`` hold the result's frames, in its order. What needs masks or truth is left out without them.
    """
    predicted, true = ObjectTrack(result.T_hand_obj, result.scale), true_track(clip)
    distances = _distances(clip, predicted, true)
    metrics, per_frame = contact_metrics(distances[0])
    symmetry = None
    if clip.truth is not None and true is not None:
        symmetries = _symmetries(clip.mesh.vertices.tobytes(), clip.mesh.faces.tobytes())
        symmetry = symmetries.describe()
        add(metrics, per_frame, "", _pose(clip.mesh, predicted, true, symmetries))
        if clip.scale == "free":
            metrics["scale_error"] = result.scale / clip.truth.scale - 1.0
        add(metrics, per_frame, "truth_", contact_metrics(distances[1]))
        for key, value in _sca(metrics):
            metrics[f"sca_add{key}"] = value * metrics["add_success"]
            metrics[f"sca_add_sym{key}"] = value * metrics["add_sym_success"]
    if masks is not None:
        masks = judged(clip, masks)
        ious = iou_of_poses(clip.mesh, result.scale, clip.hand.T_cam_hand @ result.T_hand_obj, clip.K, masks)
        add_iou(metrics, per_frame, ious)
    return {
        "clip": clip.name,
        "category": clip.category,
        "method": result.method,
        "frames": list(clip.frames),
        "symmetry": symmetry,
        "metrics": metrics,
        "per_frame": {key: values.tolist() for key, values in per_frame.items()},
    }


def _pose(mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetries: Symmetries) -> tuple[Metrics, PerFrame]:
    metrics: Metrics = {"diameter_mm": 1e3 * mesh.diameter * true.scale}
    per_frame: PerFrame = {}
    for kind, symmetry in (("", None), ("_sym", best_symmetry(mesh, predicted, true, symmetries))):
        errors = pose_errors(mesh, predicted, true, symmetry)
        frames = {
            f"add{kind}_mm": 1e3 * errors.add,
            f"rotation{kind}_deg": np.degrees(errors.rotation),
            f"translation{kind}_mm": 1e3 * errors.translation,
        }
        per_frame |= frames
        metrics |= {key: mean_of(values) for key, values in frames.items()}
        metrics[f"add{kind}_success"] = float(errors.success)
        metrics[f"add{kind}_frame_success"] = mean_of(errors.frame_success)
    return metrics, per_frame


def true_track(clip: Clip) -> ObjectTrack | None:
    """The object in the true hand's frame, where that is known."""
    if clip.truth is None:
        return None
    return ObjectTrack(se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj, clip.truth.scale)


def _distances(clip: Clip, predicted: ObjectTrack, true: ObjectTrack | None) -> list[ContactDistances]:
    """Distances of the predicted object to the hand that was given, and of the true one to the true hand."""
    given, faces = clip.hand.vertices, clip.hand.faces
    if clip.truth is None or true is None:
        return contact_distances_of(clip.mesh, [predicted], given, faces)
    if np.array_equal(clip.truth.hand_vertices, given):
        return contact_distances_of(clip.mesh, [predicted, true], given, faces)
    true_hand = contact_distances_of(clip.mesh, [true], clip.truth.hand_vertices, faces)
    return contact_distances_of(clip.mesh, [predicted], given, faces) + true_hand


def judged(clip: Clip, masks: Masks) -> Masks:
    """Masks in which the hand is ignored where nothing else is, as the methods take them."""
    return masks if masks.ignore.any() else hidden_by_hand(clip, masks)


def add_iou(metrics: Metrics, per_frame: PerFrame, ious: MaskIou) -> None:
    """Add what is known of the masks to metrics that have the SCA already."""
    per_frame |= {"iou": ious.crop, "iou_soft": ious.soft, "iou_full": ious.full}
    metrics |= {key: mean_of(per_frame[key]) for key in ("iou", "iou_soft", "iou_full")}
    for threshold in IOU_THRESHOLDS:
        above = float(metrics["iou"] > threshold)
        metrics |= {f"sca_iou_{threshold * 100:.0f}{key}": value * above for key, value in _sca(metrics)}


def contact_metrics(distances: ContactDistances) -> tuple[Metrics, PerFrame]:
    """SCA on every side, how much is in contact, and how deep hand and object are inside each other."""
    metrics, per_frame = sca_metrics(distances, SIDES)
    add(metrics, per_frame, "", penetration(distances))
    return metrics, per_frame


def sca_metrics(distances: ContactDistances, sides: Sequence[Side]) -> tuple[Metrics, PerFrame]:
    """SCA on some sides, and how much is in contact there."""
    metrics: Metrics = {}
    per_frame: PerFrame = {}
    for side in sides:
        for threshold in THRESHOLDS:
            contact, key = distances.contact(side, threshold), f"{side}_{threshold * 1e3:.0f}mm"
            overlap = pairwise_iou(contact)
            metrics[f"sca_{key}"] = stable_contact_area(overlap)
            metrics[f"sca_diagonal_{key}"] = stable_contact_area(overlap, diagonal=True)
            per_frame[f"contact_share_{key}"] = contact.mean(axis=1)
    return metrics, per_frame


def penetration(distances: ContactDistances) -> tuple[Metrics, PerFrame]:
    """How deep hand and object are inside each other."""
    metrics: Metrics = {}
    per_frame: PerFrame = {}
    for side in ("object", "hand"):
        depth = 1e3 * distances.depth(side)
        inside = depth[depth > 0.0]
        deepest = depth.max(axis=1)
        per_frame[f"penetration_{side}_mm"] = deepest
        metrics[f"penetration_{side}_mm"] = mean_of(deepest)
        metrics[f"penetration_{side}_max_mm"] = float(deepest.max())
        metrics[f"penetration_{side}_inside_mm"] = mean_of(inside) if inside.size else 0.0
    return metrics, per_frame


def add(metrics: Metrics, per_frame: PerFrame, prefix: str, more: tuple[Metrics, PerFrame]) -> None:
    """Add metrics under names with a prefix."""
    metrics |= {prefix + key: value for key, value in more[0].items()}
    per_frame |= {prefix + key: values for key, values in more[1].items()}


def _sca(metrics: Metrics) -> list[tuple[str, float]]:
    """The prediction's SCA by definition: (``_object_0mm``, value) and so on."""
    keys = [f"_{side}_{threshold * 1e3:.0f}mm" for side in SIDES for threshold in THRESHOLDS]
    return [(key, metrics[f"sca{key}"]) for key in keys if f"sca{key}" in metrics]


def mean_of(values: Float[ndarray, "n"]) -> float:
    """Mean of the values that are there (not NaN); NaN if none is."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else float("nan")


@lru_cache(maxsize=32)
def _symmetries(vertices: bytes, faces: bytes) -> Symmetries:
    """The symmetries of a mesh, found once for all the clips that hold it."""
    return find_symmetries(Mesh(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3)))


def clip_of(folder: Path, result: Reconstruction, record: dict[str, Any], clips: str | Path | None) -> Clip:
    """The clip that a result was made from."""
    if clips is not None:
        places = [Path(clips) / result.clip, Path(clips)]
    else:
        recorded = record.get("clip_folder")
        places = [Path(recorded)] if isinstance(recorded, str) and recorded else []
        places += [folder.parent / result.clip, folder.parent.parent / result.clip]
    found = next((place for place in places if _is_file(place / "clip.json")), None)
    if found is None:
        where = " or ".join(str(place) for place in places)
        expected = f"its folder at {where}; say where with --clips"
        raise InputError(folder / "result.json", "clip", f"the clip {files.shown(result.clip)}", expected)
    clip = read_clip(found)
    if clip.name != result.clip:
        raise InputError(found / "clip.json", "name", files.shown(clip.name), f"{result.clip!r}, as {folder} says")
    if record.get("input_sha256") != input_sha256(found):
        given = f"the checksum of other masks, hands or mesh than those in {found}"
        raise InputError(folder / "result.json", "input_sha256", given, "an unchanged clip; reconstruct it again")
    return clip


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a recorded path may be longer than paths can be
        return False
