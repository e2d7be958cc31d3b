"""Plain MANO parameters of all frames in one file, before the clip's camera.

``global_orient`` (T, 3) or (T, 3, 3), ``hand_pose`` (T, P), ``betas`` (10) or (T, 10), ``transl`` (T, 3) [m]. Files do
not state the meaning of ``hand_pose``, so the user must: rotation vectors, principal components or matrices; relative
to the flat hand or to MANO's mean pose. The wrong choice still looks like a hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import MissingOptionError
from getagrip.geometry import se3
from getagrip.hands.mano import Mano
from getagrip.io.options import one_of
from getagrip.provenance import assumed
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import Estimate, Estimates, HandParameters, Request, to_rotation_matrices
from getagrip.readers.trackers.read_hands import load_mano
from getagrip.readers.trackers.records import Record, Sample, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_rows, only_file

Encoding = Literal["axis-angle", "pca", "matrix"]
Mean = Literal["flat", "mean"]
MANO_DEPTH_SOURCE = assumed("transl, as the file has it; that the file assumes the clip's focal length is a guess")


@dataclass(frozen=True)
class ManoParameters(Tracker):
    """Plain MANO parameters. Both options are required."""

    name = "MANO parameters"
    takes = "plain parameters"

    looks_for = "global_orient, hand_pose, betas and transl"

    def recognises(self, sample: Sample) -> str:
        return "plain MANO parameters" if sample.has("global_orient", "hand_pose", "betas", "transl") else ""

    pose: Annotated[Encoding | None, one_of(*get_args(Encoding)), arg(help_behavior_hint="")] = None
    """Encoding of hand_pose."""
    mean: Annotated[Mean | None, one_of(*get_args(Mean)), arg(help_behavior_hint="")] = None
    """Zero of the poses: the flat hand, or MANO's mean pose."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        if self.pose is None or self.mean is None:
            missing = "--pose" if self.pose is None else "--mean"
            choices = "axis-angle, pca or matrix" if self.pose is None else "flat or mean"
            raise MissingOptionError(f"missing {missing} ({choices}): files do not state the meaning of hand_pose")
        path = only_file(paths, "parameters")
        record = records.read_tracker_record(path)
        hands = read_mano_parameters(path, record, self.pose, self.mean, load_mano(request.mano, request.side))
        frames = frames_of_rows(path, record, len(hands), request)
        seen = records.seen_joints(path, record, len(hands))
        found = [
            Estimate(path, frame, MANO_DEPTH_SOURCE, hand, seen=None if seen is None else seen[n])
            for n, (frame, hand) in enumerate(zip(frames, hands, strict=True))
            if frame is not None
        ]
        return Estimates(request.side, tuple(found), left_model="own")


def read_mano_parameters(
    path: Path, record: Record, encoding: Encoding, mean: Mean, model: Mano | None
) -> list[HandParameters]:
    """Read the hands of a file of MANO parameters. Raises ``InputError``, and ``UsageError`` without MANO's file."""
    t = record_numbers(path, record, "transl", (-1, 3))
    T = len(t)
    R = to_rotation_matrices(path, "global_orient", record_numbers(path, record, "global_orient", (T, 3), (T, 3, 3)), 1)
    betas = np.broadcast_to(record_numbers(path, record, "betas", (T, 10), (10,)), (T, 10))
    if encoding == "matrix":
        matrices = record_numbers(path, record, "hand_pose", (T, 15, 3, 3))
        values = se3.log_so3(to_rotation_matrices(path, "hand_pose", matrices, 2)).reshape(T, 45)
    elif encoding == "axis-angle":
        values = record_numbers(path, record, "hand_pose", (T, 45), (T, 15, 3)).reshape(T, 45)
    else:
        counts = range(1, 46)
        values = record_numbers(path, record, "hand_pose", *((T, count) for count in counts))
    poses = _pose_from_flat(values, encoding, mean, model)
    return [HandParameters(*each) for each in zip(R, poses, betas, t, strict=True)]


def _pose_from_flat(
    values: Float[ndarray, "T P"], encoding: Encoding, mean: Mean, model: Mano | None
) -> Float[ndarray, "T 45"]:
    """Convert poses to rotation vectors relative to the flat hand [rad]."""
    if encoding != "pca" and mean == "flat":
        return values
    if model is None:
        what = "principal components" if encoding == "pca" else "the mean pose"
        raise MissingOptionError(f"missing --mano: the folder of your MANO files, for {what}")
    return model.pose(values, "pca" if encoding == "pca" else "axis_angle", flat_hand_mean=mean == "flat")
