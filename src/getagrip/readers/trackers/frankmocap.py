"""FrankMocap's hand module: ``*_prediction_result.pkl``, one file for each image.

A list ``pred_output_list`` of people, each with ``left_hand`` and ``right_hand``: ``pred_camera`` (s, tx, ty) in a crop
of 224 px, which is ``bbox_scale_ratio`` times as large as in the image and has its corner at ``bbox_top_left``;
``pred_hand_pose`` (48) as rotation vectors, the global one first, the fingers' relative to MANO's mean pose (SMPL-X
with ``flat_hand_mean=False``); and, with ``--save_mesh``, ``pred_vertices_smpl`` (778, 3), rotated, about an origin of
their own. A missing hand is an empty dictionary, or None. A vertex X projects to (``convert_smpl_to_bbox``,
``convert_bbox_to_oriIm``)

    (u, v) = bbox_top_left + (112 / ratio) (1 + s (X + tx, Y + ty)).

Left hands are not mirrored. ``pred_hand_betas`` are a body's (SMPL-X), not MANO's, and not used: the hand has the mean
shape, moved to the mean of FrankMocap's vertices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, MissingOptionError
from getagrip.geometry import se3
from getagrip.hands.model import Side, mirrored_pose
from getagrip.io.files import shorten_value
from getagrip.provenance import estimated
from getagrip.readers.trackers.estimates import (
    ONE_CAMERA_NOTE,
    Camera,
    Estimate,
    Estimates,
    HandParameters,
    Request,
    WeakPerspective,
)
from getagrip.readers.trackers.read_hands import load_mano
from getagrip.readers.trackers.records import Record, Sample, record_numbers, seen_joints
from getagrip.readers.trackers.tracker import Tracker, per_image

FRANKMOCAP_CROP_PX = 224.0
"""Side of FrankMocap's crops [px]."""


@dataclass(frozen=True)
class FrankMocap(Tracker):
    """FrankMocap's hand module."""

    name = "FrankMocap"
    takes = "its prediction results, one for each image"

    looks_for = "pred_output_list, in *_prediction_result.pkl"

    def recognises(self, sample: Sample) -> str:
        return "FrankMocap's prediction results" if "pred_output_list" in sample.keys else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        mean = read_mean_pose(request.mano, request.side)
        found = []
        for path, frame, record in per_image(paths, request):
            hands = select_frankmocap_side(path, record, request.side)
            found += [frankmocap_estimate(path, frame, hand, request.camera(frame), mean) for hand in hands]
        return Estimates(request.side, tuple(found), scale=f"the mean hand; {ONE_CAMERA_NOTE}")


def select_frankmocap_side(path: Path, record: Record, side: Side) -> list[Record]:
    """Select the records of one side's hands, of one person or several. Raises ``InputError``."""
    people = record.get("pred_output_list") if isinstance(record, Mapping) else None
    if not isinstance(people, list) or not all(person is None or isinstance(person, Mapping) for person in people):
        got = "no such key" if people is None else shorten_value(people)
        raise InputError(path, "pred_output_list", got, "a list with a dictionary for each person")
    hands = [person.get(f"{side}_hand") for person in people if person]
    hands = [hand for hand in hands if not (hand is None or (isinstance(hand, Mapping) and not hand))]
    wrong = next((hand for hand in hands if not isinstance(hand, Mapping)), None)
    if wrong is not None:
        raise InputError(path, f"{side}_hand", shorten_value(wrong), "a dictionary")
    return hands


def read_mean_pose(folder: Path | None, side: Side) -> Float[ndarray, "45"]:
    """Read MANO's mean pose [rad], the right hand's mirrored for left hands, from the user's MANO file.

    Raises ``InputError``, and ``UsageError`` without a folder.
    """
    model = load_mano(folder, "right")
    if model is None:
        what = "FrankMocap's poses are relative to their mean pose"
        raise MissingOptionError(f"missing --mano: the folder of your MANO files: {what}")
    return mirrored_pose(model.mean) if side == "left" else model.mean


def frankmocap_estimate(path: Path, frame: int, record: Record, camera: Camera, mean: Float[ndarray, "45"]) -> Estimate:
    """Convert one record to a hand; ``mean`` is from ``read_mean_pose``. Raises ``InputError``."""
    if "pred_vertices_smpl" not in record:
        raise InputError(path, "pred_vertices_smpl", "no such key", "the key: run FrankMocap with --save_mesh")
    cam = record_numbers(path, record, "pred_camera", (3,))
    ratio = float(record_numbers(path, record, "bbox_scale_ratio", ()))
    if not (ratio > 0 and cam[0] > 0):
        key, bad = ("bbox_scale_ratio", ratio) if not ratio > 0 else ("pred_camera", cam[0])
        raise InputError(path, key, f"the scale {bad:g}", "above 0")
    side = FRANKMOCAP_CROP_PX / ratio
    corner = record_numbers(path, record, "bbox_top_left", (2,))
    weak = WeakPerspective.of_crop(corner + side / 2.0, side, cam)
    pose = record_numbers(path, record, "pred_hand_pose", (48,))
    vertices = record_numbers(path, record, "pred_vertices_smpl", (778, 3))
    t = weak.before(camera)
    parameters = HandParameters(se3.exp_so3(pose[:3]), pose[3:] + mean, np.zeros(10), t)
    depth = "weak perspective (pred_camera, bbox_top_left, bbox_scale_ratio) and the clip's focal length"
    seen = seen_joints(path, record)
    return Estimate(path, frame, estimated(depth), parameters, vertices=vertices + t, seen=seen)
