"""HaWoR's hands before the camera: ``cam_space/<0 left, 1 right>/<first>_<last>.json``, or an ``.npz`` of that layout.

``init_root_orient`` (T, 3, 3), ``init_hand_pose`` (T, 15, 3, 3), ``init_betas`` (T, 10) and ``init_trans`` (T, 3) of
the images ``first`` to ``last``, counted from 0 among those that it was run on, and optionally ``joints_2d``; rotations
of left hands turned back already, for a camera with the focal length that HaWoR was run with (``img_focal``) and its
principal point in the middle. That focal length is not in the file, so it is asked for: another one would put the hand
at another depth.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from getagrip.clip.naming import counted_elsewhere, frame_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands.trackers import records
from getagrip.hands.trackers.estimates import (
    Camera,
    Estimate,
    Estimates,
    Parameters,
    Request,
    WeakPerspective,
    rotations,
)
from getagrip.hands.trackers.records import Record, numbers
from getagrip.hands.trackers.tracker import Tracker, frames_of_rows
from getagrip.provenance import estimated

KEYS = ("init_root_orient", "init_hand_pose", "init_trans", "init_betas")


@dataclass(frozen=True)
class HaWoR(Tracker):
    """HaWoR's hands before the camera. Its focal length is needed."""

    name = "HaWoR"
    takes = "its cam_space files"

    estimator_focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="")] = None
    """The focal length that it was run with."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand in those of the files' frames that the clip has."""
        if self.estimator_focal is None:
            raise UsageError("missing --estimator-focal: the focal length that HaWoR was run with [px]")
        found = []
        for path in paths:
            record = records.read(path)
            T = length(path, record)
            seen = records.seen_joints(path, record, T)
            for n, frame in enumerate(self._frames(path, record, T, request)):
                if frame is not None:
                    parameters = row(path, record, n, T)
                    hand = estimate(path, frame, parameters, request.camera(frame), self.estimator_focal)
                    found.append(hand._replace(seen=None if seen is None else seen[n]))
        return Estimates(request.side, tuple(found))

    def _frames(self, path: Path, record: Record, count: int, request: Request) -> list[int | None]:
        """Return the index of the frame of each row, by the file's name where it holds no ``frames``."""
        named = re.fullmatch(r"(\d{1,9})_(\d{1,9})", path.stem)
        if "frames" in record or named is None:
            return frames_of_rows(path, record, count, request)
        first, last = int(named[1]), int(named[2])
        if last - first + 1 != count:
            raise InputError(path, "init_trans", f"{count} frames", f"{last - first + 1}, as the file's name says")
        names = [str(n) for n in range(first, last + 1)]
        if request.ask_first:  # nobody has said which frame its image 0 is: of a whole video it is frame 1
            of_video = [str(n) for n in range(first + 1, last + 2)]
            if counted_elsewhere(request.frames, of_video):
                request.check_numbers(path, names)
            names = of_video
        return [frame_of(name, request.frames) for name in names]


def length(path: Path, record: Record) -> int:
    """Return the number of frames in a file. Raises ``InputError``."""
    return len(numbers(path, record, "init_trans", (-1, 3)))


def row(path: Path, record: Record, n: int, frames: int) -> Record:
    """Return the parameters of one of its frames. Raises ``InputError``."""
    shapes = {"init_root_orient": ((3, 3), (3,)), "init_hand_pose": ((15, 3, 3), (15, 3), (45,))}
    shapes |= {"init_trans": ((3,),), "init_betas": ((10,),)}
    return {key: numbers(path, record, key, *((frames, *s) for s in shapes[key]))[n] for key in KEYS}


def estimate(path: Path, frame: int, record: Record, camera: Camera, focal: float) -> Estimate:
    """Convert one frame to a hand; ``focal`` [px] is HaWoR's own. Raises ``InputError``."""
    t = numbers(path, record, "init_trans", (3,))
    if not t[2] > 0:
        raise InputError(path, "init_trans", f"the depth {t[2]:g}", "a hand before the camera, above 0")
    fingers = numbers(path, record, "init_hand_pose", (15, 3, 3), (15, 3), (45,))
    matrices = rotations(path, "init_hand_pose", fingers if fingers.ndim > 1 else fingers.reshape(15, 3), 1)
    pose = se3.log_so3(matrices).reshape(45)
    R = rotations(path, "init_root_orient", numbers(path, record, "init_root_orient", (3, 3), (3,)), 0)
    weak = WeakPerspective.of_translation(t, focal, np.array(camera.size) / 2.0)
    depth = f"HaWoR's translation, its focal length {focal:.6g} px divided out and the clip's put in"
    betas = numbers(path, record, "init_betas", (10,))
    return Estimate(path, frame, estimated(depth), Parameters(R, pose, betas, weak.before(camera)))
