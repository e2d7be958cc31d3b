"""A hand tracker: 21 joints in a row of a CSV file, behind the name of the frame, in metres before the camera."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.clip.match_frames import frame_of
from getagrip.errors import InputError
from getagrip.provenance import estimated
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request
from getagrip.readers.trackers.tracker import Tracker, only_file

DEPTH = estimated("by the CSV file's tracker")


@dataclass(frozen=True)
class JointsInCsv(Tracker):
    """Joints in a CSV file."""

    name = "joints from a CSV file"
    takes = "21 joints in each row, behind the frame's name"

    csv_metres: float = 1.0
    """Metres in a unit of the CSV file's numbers."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        path = only_file(paths, "joints")
        hands = []
        for n, line in enumerate(path.read_text(encoding="utf-8").splitlines()):
            name, *values = line.split(",")
            if len(values) != 63:
                raise InputError(path, f"line {n + 1}", f"{len(values)} numbers", "63, three for each joint")
            if (frame := frame_of(name, request.frames)) is not None:
                joints = self.csv_metres * np.array(values, dtype=float).reshape(21, 3)
                hands.append(Estimate(path, frame, DEPTH, None, joints))
        return Estimates(request.side, tuple(hands))


CSV = JointsInCsv()
