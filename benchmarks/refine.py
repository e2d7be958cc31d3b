"""Refine simulated trackers' poses: ``python -m benchmarks.refine CLIPS [N]``, on N clips with ground truth.

Errors are those that trackers of rigid objects have; each is on all clips, and starts from the true poses in the
camera. A clip is right where its ADD in the camera, up to symmetries, is below 10 % of the diameter.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import store
from benchmarks.store import Cell, Column, Table
from benchmarks.timing import circumstances
from getagrip import Clip, Options, evaluate, read_clip, read_masks, reconstruct
from getagrip.clip.sampling import frame_indices
from getagrip.evaluation.other_poses import poses_of
from getagrip.fitting.options import PriorsFile
from getagrip.geometry import se3

Rng = np.random.Generator
Track = Float[ndarray, "T 4 4"]


def jitter(T: Track, clip: Clip, rng: Rng) -> Track:
    """Shift each frame by 1 cm and turn it by 5 degrees, on average."""
    return _about_centre(T, clip, rng.normal(0.0, 0.09, (len(T), 3)), rng.normal(0.0, 0.006, (len(T), 3)))


def drift(T: Track, clip: Clip, rng: Rng) -> Track:
    """Drift away by 4 cm and 40 degrees until the last frame."""
    share, (turn, shift) = np.linspace(0.0, 1.0, len(T))[:, None], rng.normal(size=(2, 3))
    return _about_centre(
        T, clip, share * 0.7 * turn / np.linalg.norm(turn), share * 0.04 * shift / np.linalg.norm(shift)
    )


def lost(T: Track, clip: Clip, rng: Rng) -> Track:
    """Stand still from a random third of the frames on, in the camera."""
    first = int(rng.integers(len(T) // 3, 2 * len(T) // 3))
    return np.concatenate([T[:first], np.tile(T[first], (len(T) - first, 1, 1))])


def flip(T: Track, clip: Clip, rng: Rng) -> Track:
    """Turn half the frames by half a turn about a random axis of the object."""
    turns = np.zeros((len(T), 3))
    turns[rng.random(len(T)) < 0.5, rng.integers(3)] = np.pi
    return _about_centre(T, clip, turns, np.zeros((len(T), 3)))


def depth(T: Track, clip: Clip, rng: Rng) -> Track:
    """Move all frames along the ray by 10 %, as by a mesh of another size."""
    out = T.copy()
    out[:, :3, 3] *= 1.1
    return out


ERRORS: dict[str, Callable[[Track, Clip, Rng], Track]] = {
    each.__name__: each for each in (jitter, drift, lost, flip, depth)
}


def _about_centre(T: Track, clip: Clip, turn: Float[ndarray, "T 3"], shift: Float[ndarray, "T 3"]) -> Track:
    """Turn the object about its centre, in its own frame, and shift it in the camera."""
    R = se3.exp_so3(turn)
    out = T @ se3.rigid(R, clip.mesh.centre - R @ clip.mesh.centre)
    out[:, :3, 3] += shift
    return out


def main(clips: Path, count: int) -> None:
    """Measure, and write ``results/refine.json``."""
    folders = sorted(path.parent for path in clips.glob("*/truth.npz"))
    folders = [folders[k] for k in frame_indices(len(folders), count)]
    rows: list[dict[str, Cell]] = []
    for name, disturb in ERRORS.items():
        found = []
        for k, folder in enumerate(folders):
            clip, masks = read_clip(folder), read_masks(read_clip(folder))
            assert clip.truth is not None
            with tempfile.TemporaryDirectory() as place:
                file = Path(place) / "poses.npz"
                T = disturb(clip.truth.T_cam_obj, clip, np.random.default_rng(k))
                np.savez(file, T_cam_obj=T, frames=np.array(clip.frames))
                before = evaluate(poses_of(file, "before", clip, masks), clip, masks)
                after = evaluate(reconstruct(clip, masks, Options(init="poses", priors=PriorsFile(file))), clip, masks)
            keys = "add_sym_cam_success", "add_sym_cam_mm"
            found.append([[one.metrics[key] for key in keys] for one in (before, after)])
        success, mm = np.moveaxis(np.array(found), -1, 0)
        rows.append(
            {
                "label": name, "clips": len(found),
                "before": float(100 * success[:, 0].mean()), "after": float(100 * success[:, 1].mean()),
                "before_mm": float(np.median(mm[:, 0])), "after_mm": float(np.median(mm[:, 1])),
                "lost": int(np.count_nonzero(success[:, 0] > success[:, 1])),
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
    columns = [
        Column("clips", "clips"), Column("before", "right before", "%", 0), Column("after", "after", "%", 0),
        Column("before_mm", "ADD sym. before", "mm", 1), Column("after_mm", "after", "mm", 1),
        Column("lost", "clips lost"),
    ]  # fmt: skip
    command = f"python -m benchmarks.refine CLIPS {count}"
    print(store.write("refine", Table("Poses of simulated trackers, refined", circumstances(command), columns, rows)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 12)
