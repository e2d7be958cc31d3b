"""How often the object is found: every category of made-up clips, several seeds, exact and noisy input, no selection.

    python benchmarks/accuracy.py [seeds] > docs/accuracy.md

Default options throughout. One clip is one (category, seed); its noise comes from the same seed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from statistics import mean, median

import numpy as np

from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.scene import Options as ClipOptions
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.fitting.reconstruct import reconstruct
from getagrip.geometry import se3
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries

CONDITIONS = {
    "exact hands and masks": ClipOptions(),
    "hands off by 3 degrees and 6 mm, ragged masks": ClipOptions(
        hand_bias_deg=3.0, hand_bias_mm=6.0, mask_ragged_px=2.0
    ),
}

PAGE = """# How often the object is found

Made by `python benchmarks/accuracy.py {seeds}`: {categories} categories of made-up clips, seeds 0 to {last}, default
options, no clip left out. An ADD below 10 % of the diameter counts as a success; "sym." is up to the object's own
symmetries; mm, degrees and seconds are medians. "Of failures": how many of the failures (sym.) were marked `ambiguous`.

The mesh that is fitted is the one the masks were rendered from, which no recording ever offers: an upper bound."""


@dataclass(frozen=True)
class Score:
    """One clip's outcome."""

    category: str
    success: bool
    """ADD below 10 % of the diameter, in the true hand's frame."""
    success_symmetric: bool
    """The same up to the object's symmetries."""
    add: float
    """ADD up to symmetries [m]."""
    rotation: float
    """Rotation error up to symmetries [rad]."""
    ambiguous: bool
    seconds: float


def score(category: str, clip: Clip, masks: Masks) -> Score:
    """Reconstruct a clip and compare with its truth."""
    result = reconstruct(clip, masks)
    index = [clip.frames.index(name) for name in result.frames]
    truth = clip.truth
    assert truth is not None
    true = ObjectTrack((se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj)[index], truth.scale)
    found = ObjectTrack(result.T_hand_obj, result.scale)
    plain = pose_errors(clip.mesh, found, true)
    symmetric = pose_errors(clip.mesh, found, true, best_symmetry(clip.mesh, found, true, find_symmetries(clip.mesh)))
    return Score(
        category,
        plain.success,
        symmetric.success,
        float(symmetric.add.mean()),
        float(symmetric.rotation.mean()),
        result.ambiguous,
        result.seconds["total"],
    )


def table(scores: dict[str, list[Score]]) -> list[str]:
    """Markdown rows: one per group of scores."""
    heads = ["", "clips", "ADD %", "ADD sym. %", "ADD sym. mm", "rotation sym. °", "ambiguous %", "of failures", "s"]
    rows = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for name, group in scores.items():
        failed = [s for s in group if not s.success_symmetric]
        rows.append(
            f"| {name} | {len(group)} | {100 * mean(s.success for s in group):.0f} "
            f"| {100 * mean(s.success_symmetric for s in group):.0f} | {1000 * median(s.add for s in group):.1f} "
            f"| {np.degrees(median(s.rotation for s in group)):.1f} | {100 * mean(s.ambiguous for s in group):.0f} "
            f"| {sum(s.ambiguous for s in failed)} of {len(failed)} | {median(s.seconds for s in group):.2f} |"
        )
    return rows


def main(seeds: int) -> None:
    """Print the page."""
    print(PAGE.format(seeds=seeds, last=seeds - 1, categories=len(CATEGORIES)))
    for condition, options in CONDITIONS.items():
        scores: dict[str, list[Score]] = {"all": []}
        for category in CATEGORIES:
            scores[category] = [score(category, *synthesise(category, seed, options)) for seed in range(seeds)]
            scores["all"] += scores[category]
            print(condition, category, scores[category][-1], file=sys.stderr)
        print(f"\n## {condition.capitalize()}\n", *table(scores), sep="\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
