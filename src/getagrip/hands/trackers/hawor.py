"""HaWoR's hands before the camera: ``cam_space/<0 left, 1 right>/<first>_<last>.json``, or an ``.npz`` of that layout.

``init_root_orient`` (T, 3, 3), ``init_hand_pose`` (T, 15, 3, 3), ``init_betas`` (T, 10) and ``init_trans`` (T, 3) of
the images ``first`` to ``last``, counted from 0 among those that it was run on; rotations of left hands turned back
already, for a camera with the focal length that HaWoR was run with (``img_focal``) and its principal point in the
middle. That focal length is not in the file, so it is asked for: another one would put the hand at another depth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.trackers.estimates import Camera, Seen, rotations
from getagrip.hands.trackers.records import Record, numbers
from getagrip.hands.trackers.weak_perspective import WeakPerspective

KEYS = ("init_root_orient", "init_hand_pose", "init_trans", "init_betas")


def length(path: Path, record: Record) -> int:
    """How many frames a file holds. Raises ``InputError``."""
    return len(numbers(path, record, "init_trans", (-1, 3)))


def row(path: Path, record: Record, n: int, frames: int) -> Record:
    """The parameters of one of its frames. Raises ``InputError``."""
    shapes = {"init_root_orient": ((3, 3), (3,)), "init_hand_pose": ((15, 3, 3), (15, 3), (45,))}
    shapes |= {"init_trans": ((3,),), "init_betas": ((10,),)}
    return {key: numbers(path, record, key, *((frames, *s) for s in shapes[key]))[n] for key in KEYS}


def seen(path: Path, record: Record, camera: Camera, focal: float) -> tuple[Seen, str]:
    """The hand of one frame, and where its depth comes from; ``focal`` [px] is HaWoR's own. Raises ``InputError``."""
    t = numbers(path, record, "init_trans", (3,))
    if not t[2] > 0:
        raise InputError(path, "init_trans", f"the depth {t[2]:g}", "a hand before the camera, above 0")
    fingers = numbers(path, record, "init_hand_pose", (15, 3, 3), (15, 3), (45,))
    matrices = rotations(path, "init_hand_pose", fingers if fingers.ndim > 1 else fingers.reshape(15, 3), 1)
    pose = se3.log_so3(matrices).reshape(45)
    R = rotations(path, "init_root_orient", numbers(path, record, "init_root_orient", (3, 3), (3,)), 0)
    weak = WeakPerspective.of_translation(t, focal, np.array(camera.size) / 2.0)
    depth = f"HaWoR's translation, its focal length {focal:.6g} px divided out and the clip's put in"
    return Seen(R, pose, numbers(path, record, "init_betas", (10,)), weak.before(camera)), depth
