"""Plain joints, over all frames in one file, already before the clip's camera: ``joints`` (T, 21, 3) [m]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from getagrip.errors import InputError, UsageError
from getagrip.hands.fit import ORDERS
from getagrip.hands.trackers import records
from getagrip.hands.trackers.estimates import Estimate, Estimates, Request
from getagrip.hands.trackers.joint_checks import Order, check_before_camera, in_order
from getagrip.hands.trackers.records import numbers
from getagrip.hands.trackers.tracker import Tracker, frames_of_rows, only_file
from getagrip.io import files
from getagrip.io.arguments import one_of
from getagrip.provenance import assumed

DEPTH = assumed("joints before the camera, as the file has them; that it was the clip's camera is a guess")


@dataclass(frozen=True)
class Joints(Tracker):
    """Plain joints. Their order is needed."""

    name = "joints from a file"
    takes = "21 of them in metres, before the camera"

    order: Annotated[Order | None, one_of(*ORDERS, "auto"), arg(help_behavior_hint="")] = None
    """Their order (docs/hands.md); auto: the one in which they fit a hand."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the joints in those of the file's frames that the clip has."""
        if self.order is None:
            raise UsageError("missing --order (openpose, ho3d or auto): the order of the joints is in no file")
        path = only_file(paths, "joints")
        record = records.read(path)
        points = numbers(path, record, "joints", (-1, 21, 3))
        check_before_camera(path, points)
        frames = frames_of_rows(path, record, len(points), request)
        ordered = in_order(path, points, self.order, request.side)
        seen = records.seen_joints(path, record, len(points))
        found = [
            Estimate(path, frame, DEPTH, None, hand, seen=None if seen is None else seen[row])
            for row, (frame, hand) in enumerate(zip(frames, ordered.joints, strict=True))
            if frame is not None
        ]
        if not found:
            got = f"hands in other frames ({files.plain(str(np.asarray(record['frames'])[0]))}, ...)"
            named = " to ".join(files.plain(frame) for frame in (request.frames[0], request.frames[-1]))
            raise InputError(path, "frames", got, f"hands in the clip's, {named}")
        scale = "; ".join(filter(None, ["the joints, as the file has them", ordered.chosen]))
        return Estimates(request.side, tuple(found), scale=scale, warning=ordered.warning)
