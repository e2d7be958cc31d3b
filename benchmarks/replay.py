"""How well ``replay`` tells grasps from none: ``python -m benchmarks.replay NAME CLIPS [N]``.

N clips with ground truth, evenly sampled: their true poses, and the same moved 30 mm to where the hand is farthest, at
most to the side and never up.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks import store
from benchmarks.store import Cell, Column, Table
from benchmarks.timing import circumstances
from getagrip import Reconstruction, read_clip
from getagrip.export import Scene
from getagrip.export.replay import replay
from getagrip.export.stage import Stage
from getagrip.geometry import se3

BY, WAYS = 0.03, 300
"""How far the object is moved [m], and the number of ways tried."""


def moved(scene: Scene) -> Scene:
    """Move the object away from the hand, not upwards."""
    up = (Stage.of(scene).T_stage_cam @ scene.T_cam_hand)[0, 2, :3]
    points, hand = se3.transform(scene.T_hand_obj[0], scene.object.vertices), cKDTree(scene.hand_vertices[0])
    ways = np.random.default_rng(0).normal(size=(WAYS, 3))
    ways = ways[ways @ up < 0.0] / np.linalg.norm(ways[ways @ up < 0.0], axis=1, keepdims=True)
    T = scene.T_hand_obj.copy()
    T[:, :3, 3] += BY * max(ways, key=lambda way: hand.query(points + BY * way)[0].min())
    return replace(scene, T_hand_obj=T)


def main(name: str, clips: Path, count: int = 10**6) -> None:
    """Measure, and write ``results/NAME-replay.json`` after each clip."""
    folders = sorted(path.parent for path in clips.glob("*/truth.npz"))
    if count < len(folders):
        folders = [folders[k] for k in np.linspace(0, len(folders) - 1, count).round().astype(int)]
    columns = [
        Column("clips", "clips"),
        Column("stays", "stays in the hand, frames", "%", 0),
        Column("held", "clips in which it always stays", "%", 0),
    ]
    made = circumstances(f"python -m benchmarks.replay {name} CLIPS {len(folders)}")
    found: dict[str, list[float]] = {"true poses": [], "moved by 30 mm": []}
    for folder in folders:
        clip = read_clip(folder)
        assert clip.truth is not None
        T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
        scene = Scene.of(Reconstruction.external(clip.name, "static", clip.frames, T, clip.truth.scale), clip)
        for label, one in zip(found, (scene, moved(scene)), strict=True):
            found[label].append(replay(one).stays)
        rows: list[dict[str, Cell]] = [
            {"label": label, "clips": len(values), "stays": 100.0 * float(np.mean(values)),
             "held": 100.0 * float(np.mean(np.array(values) == 1.0))}
            for label, values in found.items()
        ]  # fmt: skip
        print(folder.name, *(f"{values[-1]:.2f}" for values in found.values()), flush=True)
        store.write(f"{name}-replay", Table("Objects that stay in the simulated hand", made, columns, rows))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:]))
