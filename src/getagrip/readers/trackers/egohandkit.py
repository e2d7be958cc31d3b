"""EgoHandKit's results: a pickle of MANO's parameters by image, or ``hand_tracking.parquet`` with joints.

``<name>_<backend>.pkl`` holds, for each image, lists ``mano`` (with ``is_right``), ``cam_trans`` (3) and
``backend_meta``, in HaMeR's conventions for all networks; ``final/results.pkl`` (``egohand.results.v1``) has the same
content as ``hands`` of each of ``frames``. HaWoR's translations are for the focal length ``img_focal`` in
``backend_meta``, the other networks' for HaMeR's. The Parquet file holds joints before the camera [m], in OpenPose's
order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.errors import InputError
from getagrip.provenance import estimated
from getagrip.readers.streams import read_columns
from getagrip.readers.trackers import hamer, records
from getagrip.readers.trackers.egodex import MAX_EPISODE_FRAMES
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request
from getagrip.readers.trackers.read_hands import check_before_camera
from getagrip.readers.trackers.records import Record, Sample, record_numbers
from getagrip.readers.trackers.tracker import (
    Tracker,
    frames_of_images,
    frames_of_names,
    only_file,
    unmatched_names_error,
)

EGOHANDKIT_TABLE = "hand_tracking.parquet"
EGOHANDKIT_DEPTH_SOURCE = estimated("EgoHandKit's joints before its camera, as the file has them")


@dataclass(frozen=True)
class EgoHandKit(Tracker):
    """The hands of EgoHandKit's run, of any of its networks."""

    name = "EgoHandKit"
    takes = "its run's folder, *_hawor.pkl and the like, results.pkl or hand_tracking.parquet"
    looks_for = "mano, cam_trans and backend_meta by image, results.pkl, hand_tracking.parquet"
    layouts = ("final/results.pkl", "results.pkl", *(f"*_{name}.pkl" for name in ("hawor", "hamer", "htm", "wilor")))

    def recognises(self, sample: Sample) -> str:
        if sample.path.name == EGOHANDKIT_TABLE:
            return "EgoHandKit's joints"
        named = str(sample.record.get("schema_version", "")).startswith("egohand.results")
        return "EgoHandKit's results" if named or sample.has("mano", "cam_trans", "backend_meta") else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        path = only_file(paths, "hands")
        if path.suffix.lower() == ".parquet":
            return _read_parquet_joints(path, request)
        images = _hamer_records_by_image(path, records.read_tracker_record(path))
        frames = dict(zip(images, frames_of_names(path, list(images), request), strict=True))
        if all(frame is None for frame in frames.values()):
            raise unmatched_names_error(paths, next(iter(images), path.name), request)
        found = [
            hamer.hamer_estimate(path, frame, one, request)
            for name, frame in frames.items()
            if frame is not None
            for hand in images[name]
            for one in hamer.select_hamer_side(path, hand, request.side)
        ]
        return Estimates(request.side, tuple(found))


def _hamer_records_by_image(path: Path, record: Record) -> dict[str, list[Record]]:
    """Return the hands of each image as HaMeR's records. Raises ``InputError``."""
    images: dict[str, list[Record]] = {}
    try:
        if "frames" in record:
            listed = {str(frame["img_path"]): frame["hands"] for frame in record["frames"]}
            parts = {name: [(one["mano"], one["cam_trans"], one["meta"]) for one in of] for name, of in listed.items()}
        else:
            keys = ("mano", "cam_trans", "backend_meta")
            parts = {str(name): list(zip(*(of[key] for key in keys), strict=True)) for name, of in record.items()}
        for name, hands in parts.items():
            images[name] = []
            for mano, t, meta in hands:
                focal = {"scaled_focal_length": meta["img_focal"]} if "img_focal" in meta else {}
                images[name].append({**mano, "pred_cam_t_full": t, **focal})
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "", f"other records ({error!r})", "mano, cam_trans and backend_meta by image") from error
    return images


def _read_parquet_joints(path: Path, request: Request) -> Estimates:
    """Read the joints of a side from the Parquet file. Raises ``InputError``, and ``UsageError`` without pyarrow."""
    key = f"{request.side}_joints_3d"
    table = read_columns(path, ["frame_idx", key])
    there = np.flatnonzero(~np.isnan(table[key].reshape(len(table[key]), -1)).all(axis=1))
    if not len(there):
        return Estimates(request.side, ())
    if table[key].shape[1:] != (63,):
        raise InputError(path, key, f"rows of {table[key].shape[1:]} numbers", "21 joints of 3 numbers")
    joints = record_numbers(path, {key: table[key][there].reshape(-1, 21, 3)}, key, (len(there), 21, 3))
    indices = record_numbers(path, table, "frame_idx", (len(table[key]),)).astype(int)
    if indices.min() < 0 or indices.max() >= MAX_EPISODE_FRAMES:
        got = f"{indices.min()} to {indices.max()}"
        raise InputError(path, "frame_idx", got, f"indices of the images, from 0 and below {MAX_EPISODE_FRAMES}")
    check_before_camera(path, joints)
    frames = frames_of_images(path, {}, int(indices.max()) + 1, request)
    found = [
        Estimate(path, frame, EGOHANDKIT_DEPTH_SOURCE, None, hand)
        for row, hand in zip(there, np.asarray(joints), strict=True)
        if (frame := frames[indices[row]]) is not None
    ]
    return Estimates(request.side, tuple(found), scale="the joints, as EgoHandKit has them")
