"""Plain joints of all frames in one file, before the clip's camera: ``joints`` (T, 21, 3) [m]; SOMA's 25 joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import InputError, MissingOptionError
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.io.files import printable
from getagrip.io.options import one_of
from getagrip.provenance import assumed
from getagrip.readers.trackers import hamer_demo, records
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request
from getagrip.readers.trackers.read_hands import Order, check_before_camera, reorder_joints
from getagrip.readers.trackers.records import Sample, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_rows, only_file

JOINTS_DEPTH_SOURCE = assumed("joints before the camera, as the file has them; that it is the clip's camera is a guess")


SOMA_JOINT_INDICES = [0, 1, 2, 3, 4, *range(6, 10), *range(11, 15), *range(16, 20), *range(21, 25)]
"""Index of each of this package's 21 joints among SOMA's 25, whose four fingers have a metacarpal joint each."""


@dataclass(frozen=True)
class Joints(Tracker):
    """Plain joints. Their order is required."""

    name = "joints from a file"
    takes = "21 of them in metres, before the camera"

    looks_for = "joints (T, 21, 3)"

    def recognises(self, sample: Sample) -> str:
        of_demo = sample.path.stem.endswith(hamer_demo.DEMO_JOINTS_SUFFIX)
        if np.shape(sample.record.get("joints", ()))[-2:] != (21, 3) or of_demo:
            return ""
        return "21 joints in every frame"

    order: Annotated[Order | None, one_of(*JOINT_ORDERS, "auto"), arg(help_behavior_hint="")] = None
    """Order of the joints (docs/hands.md); auto: the order in which they fit a hand."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        if self.order is None:
            raise MissingOptionError("missing --order (openpose, ho3d or auto): the order of the joints is in no file")
        path = only_file(paths, "joints")
        record = records.read_tracker_record(path)
        return joint_estimates(path, record, record_numbers(path, record, "joints", (-1, 21, 3)), self.order, request)


@dataclass(frozen=True)
class Soma(Tracker):
    """SOMA's 25 joints, as py-soma-x has them and EgoHand estimates them."""

    name = "SOMA"
    takes = "joints (T,25,3) in metres, before the camera, as of EgoHand"
    looks_for = "joints (T, 25, 3)"

    def recognises(self, sample: Sample) -> str:
        return "SOMA's 25 joints" if np.shape(sample.record.get("joints", ()))[-2:] == (25, 3) else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the joints in the clip's frames, without the metacarpal joints."""
        path = only_file(paths, "joints")
        record = records.read_tracker_record(path)
        points = record_numbers(path, record, "joints", (-1, 25, 3))[:, SOMA_JOINT_INDICES]
        return joint_estimates(path, record, points, "openpose", request)


def joint_estimates(
    path: Path, record: records.Record, points: Float[ndarray, "T 21 3"], order: Order, request: Request
) -> Estimates:
    """Return the hands of joints before the camera [m], in a file's order. Raises ``InputError``."""
    check_before_camera(path, points)
    frames = frames_of_rows(path, record, len(points), request)
    ordered = reorder_joints(path, points, order, request.side)
    seen = records.seen_joints(path, record, len(points)) if "joints_2d" in record else None
    found = [
        Estimate(path, frame, JOINTS_DEPTH_SOURCE, None, hand, seen=None if seen is None else seen[row])
        for row, (frame, hand) in enumerate(zip(frames, ordered.joints, strict=True))
        if frame is not None
    ]
    if not found:
        got = f"hands in other frames ({printable(str(np.asarray(record['frames'])[0]))}, ...)"
        named = " to ".join(printable(frame) for frame in (request.frames[0], request.frames[-1]))
        raise InputError(path, "frames", got, f"hands in the clip's, {named}")
    scale = "; ".join(filter(None, ["the joints, as the file has them", ordered.chosen]))
    return Estimates(request.side, tuple(found), scale=scale, warning=ordered.warning)
