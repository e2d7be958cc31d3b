"""How results differ between CPUs: the same clips as on this machine, and with what other CPUs would compute with.

OpenBLAS, numpy and numba each choose by the CPU which instructions they use, and so in which order sums are added up.
Run directly, ``python -m benchmarks.cpus CLIP...`` prints what is found for each clip as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy._core import _multiarray_umath as umath

from benchmarks.page import table
from getagrip.clip import Clip, read_clip, write_clip
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.fitting.reconstruct import reconstruct
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.pose import ObjectTrack, PoseErrors, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries

CATEGORIES = ("mug", "pan", "kettle", "scissors", "can", "box", "bottle", "phone")
SEEDS = range(4)
FRAMES = 12
CLOSE, NEAR = 0.01, 1.0
"""Of two results, in mm and in degrees: the first is what docs/batch.md states."""
ROOT = Path(__file__).resolve().parents[1]
CHOSEN = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_CACHE_DIR")
"""What may be set already; the baseline is without."""


@dataclass(frozen=True)
class Found:
    """Of a clip."""

    track: ObjectTrack
    """In the hand."""
    iou: float
    energy: float
    """[px^2 of the 256-pixel crop]."""


def main(folders: list[str]) -> None:
    """Reconstruct clips; print what is found as a line of JSON for each."""
    for folder in folders:
        result = reconstruct(read_clip(folder))
        print(json.dumps([result.T_hand_obj.tolist(), result.scale, result.mean_iou, result.energy["total"]]))


def section() -> str:
    """Measure; the section's text."""
    made = [synthesise(category, seed, SceneOptions(frames=FRAMES)) for category in CATEGORIES for seed in SEEDS]
    clips = [clip for clip, _ in made]
    with tempfile.TemporaryDirectory() as scratch:
        folders = [write_clip(clip, masks, Path(scratch) / clip.name) for clip, masks in made]
        cache = {"NUMBA_CACHE_DIR": str(Path(scratch) / "cache")}
        baseline = _results(folders, cache)
        rows = [
            [name, *_row(clips, baseline, _results(folders, settings | cache))] for name, settings in _others().items()
        ]
    counts = ["to the bit", f"within {CLOSE:g} mm and degrees", f"within {NEAR:g} mm and degree", "beyond"]
    return "\n\n".join([
        f"{len(folders)} clips of {FRAMES} frames, default options. How many are as this machine computes them by "
        "itself, and the largest differences, poses up to the object's symmetries:",
        table(["", *counts, "ADD, mm", "IOU", "energy, %", "clips that are right"], rows),
    ])  # fmt: skip


def _others() -> dict[str, dict[str, str]]:
    """What other CPUs would compute with: environment variables by a name."""
    found = {feature for feature, here in umath.__cpu_features__.items() if here}
    dispatched = [feature for feature in umath.__cpu_dispatch__ if feature in found]
    no_avx512 = {"NPY_DISABLE_CPU_FEATURES": " ".join(feature for feature in dispatched if feature != "X86_V3")}
    no_avx = {"NPY_DISABLE_CPU_FEATURES": " ".join(dispatched)}
    haswell = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": ""}
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    return {
        "the same once more": {},
        "OpenBLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
        "OpenBLAS for Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
        "OpenBLAS for Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
        "numpy without AVX-512": no_avx512,
        "numpy without AVX": no_avx,
        "kernels for Haswell": haswell,
        "kernels for any x86-64": generic,
        "all three for Haswell": {"OPENBLAS_CORETYPE": "Haswell", **no_avx512, **haswell},
        "all three without AVX": {"OPENBLAS_CORETYPE": "Nehalem", **no_avx, **generic},
    }


def _results(folders: list[Path], settings: dict[str, str]) -> list[Found]:
    """What a process with such environment variables finds."""
    environment = {name: value for name, value in os.environ.items() if name not in CHOSEN}
    command = [sys.executable, "-m", "benchmarks.cpus", *map(str, folders)]
    process = subprocess.run(
        command, env=environment | settings, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True
    )
    lines = [json.loads(line) for line in process.stdout.splitlines()]
    return [Found(ObjectTrack(np.array(T), scale), iou, energy) for T, scale, iou, energy in lines]


def _row(clips: list[Clip], baseline: list[Found], other: list[Found]) -> list[str]:
    """Of a variant."""
    found = [_difference(clip.mesh, a, b) for clip, a, b in zip(clips, baseline, other, strict=True)]
    apart, add, iou, energy = np.transpose(found)
    counts = [apart == 0.0, (apart > 0.0) & (apart <= CLOSE), (apart > CLOSE) & (apart <= NEAR), apart > NEAR]
    largest = [f"{add.max():.2f}", f"{iou.max():.4f}", f"{energy.max():.2f}"]
    return [*(f"{np.sum(count)}" for count in counts), *largest, f"{sum(map(_is_right, clips, other))}"]


def _is_right(clip: Clip, found: Found) -> bool:
    """Whether ADD is below 10 % of the diameter, up to symmetries."""
    truth = clip.truth
    assert truth is not None
    true = ObjectTrack(se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj, truth.scale)
    return _errors(clip.mesh, found.track, true).success


def _errors(mesh: Mesh, found: ObjectTrack, true: ObjectTrack) -> PoseErrors:
    """Up to the object's symmetries."""
    return pose_errors(mesh, found, true, best_symmetry(mesh, found, true, find_symmetries(mesh)))


def _difference(mesh: Mesh, a: Found, b: Found) -> tuple[float, float, float, float]:
    """How far apart the poses are, the larger of mm and degrees; ADD up to symmetries [mm]; of IOU and energy [%]."""
    poses = [
        (found.track.T_ref_obj[:, :3, :3], se3.transform(found.track.T_ref_obj, mesh.centre[None])[:, 0])
        for found in (a, b)
    ]
    (Ra, a_centre), (Rb, b_centre) = poses
    same = np.array_equal(a.track.T_ref_obj, b.track.T_ref_obj)
    degrees = 0.0 if same else float(np.degrees(se3.angle_between(Ra, Rb).max()))
    moved = 1e3 * float(np.linalg.norm(a_centre - b_centre, axis=-1).max())
    add = 1e3 * float(_errors(mesh, a.track, b.track).add.max())
    return max(degrees, moved), add, abs(a.iou - b.iou), 100.0 * abs(b.energy / a.energy - 1.0)


if __name__ == "__main__":
    main(sys.argv[1:])
