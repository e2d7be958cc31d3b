"""Is the hand wrong, or the object? ``python -m benchmarks.hand_or_object DIR...`` writes into the pages of results.

Each DIR is a folder that was given to ``bench --out``, and is named like the dataset: the tables go between the markers
"<name>-hand-or-object". Nothing is reconstructed: stored results are held against their clips, changed as the ablations
of hands have changed them. In each table are the clips that all its rows have, and the methods that met wrong hands.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from getagrip.clip import read_clip, read_masks
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_SYM, ADD_SYM_CAM
from getagrip.experiments.settings import ABLATIONS
from getagrip.experiments.stamp import stamp
from getagrip.experiments.variants import Variant, ablation_variants
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.result import read_result

OF_HANDS = ("hand-noise", "hand-correction", "estimated-hands", "true-hands")
"""The ablations in which hands are off."""
SEEN = 0.05
"""Smaller errors are zero in the tables [deg, mm]."""
HEADER = (
    "", "right in the hand, %", "right in the camera, %", "hand, constant, °", "mm", "hand, changing, °", "mm",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A result."""

    in_hand: float
    """1 where the object is right in the hand, else 0."""
    in_camera: float
    """The same in the camera."""
    hand: tuple[float, float, float, float]
    """What ``left_of`` gives."""
    code: str
    """Which code made it."""


def left_of(error: Float[ndarray, "T 4 4"]) -> tuple[float, float, float, float]:
    """The constant part of a hand's errors [deg, mm], and means of what changes from frame to frame [deg, mm]."""
    constant = se3.rigid(se3.nearest_rotation(error[:, :3, :3].mean(axis=0)), error[:, :3, 3].mean(axis=0))
    (always, there), (changing, about) = _sizes(constant[None]), _sizes(se3.inverse(constant) @ error)
    return always, there, changing, about


def _sizes(T: Float[ndarray, "n 4 4"]) -> tuple[float, float]:
    """Mean angle [deg] and length [mm] of motions."""
    angle = np.degrees(se3.angle_between(T[:, :3, :3], np.eye(3)[None])).mean()
    return float(angle), 1e3 * float(np.linalg.norm(T[:, :3, 3], axis=1).mean())


def case(place: Path, folder: Path, variant: Variant) -> Case:
    """A result beside its clip as the variant has it."""
    result, record = read_result(place)
    clip = read_clip(folder)
    clip, _ = variant.change(clip, read_masks(clip), variant.options.seed)
    assert clip.truth is not None
    metrics = evaluate(result, clip, wanted=(ADD_SYM, ADD_SYM_CAM)).metrics
    clip = clip.take(clip.index_of(result.frames)).with_hand_at(result.T_cam_hand)
    assert clip.truth is not None
    error = se3.inverse(clip.truth.T_cam_hand) @ clip.hand.T_cam_hand
    return Case(metrics[ADD_SYM.name], metrics[ADD_SYM_CAM.name], left_of(error), record["software"]["code"])


def row(variant: Variant, cases: Mapping[str, Case]) -> list[str]:
    """Means of the shares, medians of the errors."""
    shares = (np.mean([getattr(case, key) for case in cases.values()]) for key in ("in_hand", "in_camera"))
    errors = np.median([case.hand for case in cases.values()], axis=0)
    return [variant.label, *(f"{100.0 * share:.1f}" for share in shares), *(f"{error:.1f}" for error in errors)]


def tables(folder: Path) -> Iterator[str]:
    """A table for each ablation that the folder has results of."""
    clips = {path.parent.name: path.parent for path in (folder / "clips").rglob("clip.json")}
    for name in OF_HANDS:
        variants = {v: folder / "results" / v.folder for v in ablation_variants(name, list(METHODS), Options())}
        there = {v: place for v, place in variants.items() if place.is_dir()}
        if not any("+" in v.folder for v in there):
            continue
        shared = sorted(set.intersection(*({p.name for p in place.iterdir()} for place in there.values())))
        found = {v: {n: case(place / n, clips[n], v) for n in shared} for v, place in there.items()}
        off = {v.method for v, cases in found.items() if any(max(each.hand) > SEEN for each in cases.values())}
        found = {v: cases for v, cases in found.items() if v.method in off}
        codes = sorted({case.code for cases in found.values() for case in cases.values()})
        about = (
            f"*{ABLATIONS[name].title}: {len(shared)} clips. Made {stamp()}, of results of code {', '.join(codes)}.*"
        )
        yield f"{about}\n\n{page.table(HEADER, [row(v, cases) for v, cases in found.items()])}"


def main(folders: list[Path]) -> None:
    """Update the pages."""
    for folder in folders:
        text = "\n\n".join(tables(folder))
        page.write(f"{folder.name}-hand-or-object", text)
        print(text, flush=True)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
