"""A file of tracks in this package's own layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from getagrip.hands.model import Side
from helpers.recorded_joints import recording, write_parts


def content(holder: Side = "right") -> dict[str, Any]:
    """A file's arrays, of one hand and a rigid box."""
    of = recording(holder)
    return {
        f"joints_{holder}": of.joints[holder],
        "order": "openpose",
        "T_world_obj": of.T_world_obj,
        "mesh": "box.obj",
        "fps": 25,
        "category": "box",
        "subject": "ann",
        "sequence": "box-1",
    }


def write(folder: Path, **changes: Any) -> Path:
    """A file of ``content`` with some arrays changed, or left out where they are None."""
    write_parts(folder / "box.obj", folder / "lid.obj")
    given = {key: value for key, value in {**content(), **changes}.items() if value is not None}
    np.savez(folder / "one.npz", **given)
    return folder / "one.npz"
