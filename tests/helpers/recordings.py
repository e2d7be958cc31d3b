"""A recording as ``bench recording`` reads it: one view, whose camera is the world."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io.images import write_depth, write_image


def write_recording(root: Path, clip: Clip, images: Iterable[np.ndarray], depths: Iterable[np.ndarray] = ()) -> Path:
    """Images of a clip's frames, perhaps depth [m, 0 where unknown], and the clip's truth."""
    assert clip.truth is not None
    for n, image in enumerate(images):
        (root / "front" / "color").mkdir(parents=True, exist_ok=True)
        write_image(root / "front" / "color" / f"{clip.frames[n]}.png", image)
    for n, depth in enumerate(depths):
        (root / "front" / "depth").mkdir(parents=True, exist_ok=True)
        write_depth(root / "front" / "depth" / f"{clip.frames[n]}.png", (1e3 * depth).round().astype(np.uint16))
    K = clip.K[0]
    camera = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "T_world_cam": np.eye(4).tolist()}
    (root / "cameras.json").write_text(json.dumps({"front": camera}))
    truth = {"frames": np.array(clip.frames), "T_world_obj": clip.truth.T_cam_obj}
    if clip.hand.joints is not None:
        truth["joints_world"] = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    np.savez(root / "truth.npz", **truth)  # type: ignore[arg-type]
    write_mesh(clip.mesh, root / "object.obj")
    return root
