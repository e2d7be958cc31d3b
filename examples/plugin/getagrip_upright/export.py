"""An export: how far the object is tilted in each frame."""

from pathlib import Path

import numpy as np

from getagrip.export import Scene
from getagrip_upright.upright import tilt


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write one file into an empty folder; returns what each file holds."""
    rows = zip(scene.frames, np.degrees(tilt(scene.T_cam_obj[:, :3, :3])), strict=True)
    (folder / "tilt.txt").write_text("".join(f"{frame} {angle:.1f}\n" for frame, angle in rows), encoding="utf-8")
    return {"tilt.txt": "a line per frame: its name, and the angle of the object's z axis to the vertical in degrees"}
