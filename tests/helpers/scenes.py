"""Synthetic clips that several tests look at, made once in each process, and how near results come to the truth.

Nothing may be changed in the clips.
"""

from __future__ import annotations

from functools import cache

from getagrip.clip import Clip, Masks
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import METRICS
from getagrip.result import Axis, Reconstruction
from getagrip.synthetic.noise import perturbed
from getagrip.synthetic.scene import ground_truth_masks, make_scene, noise_seed
from getagrip.synthetic.scene_options import SceneOptions

SMALL = SceneOptions(frames=8, size=(320, 240), focal=300.0)
SHORT = SceneOptions(frames=4, size=(320, 240), focal=300.0)


@cache
def scene_with_axis(category: str, seed: int, options: SceneOptions = SMALL) -> tuple[Clip, Masks, Axis]:
    """As ``synthesise`` makes it, and the axis that the object turns about."""
    made = make_scene(category, seed, options)
    noise = noise_seed(category, seed)
    return *perturbed(made.clip, ground_truth_masks(made), made.options, noise), made.axis


def scene(category: str, seed: int, options: SceneOptions = SMALL) -> tuple[Clip, Masks]:
    return scene_with_axis(category, seed, options)[:2]


def scores(result: Reconstruction, clip: Clip, masks: Masks) -> dict[str, float]:
    """Metrics of masks and poses alone: those of contact take as long as a reconstruction."""
    wanted = [metric for metric in METRICS.values() if metric.name.startswith(("iou", "add", "scale"))]
    metrics: dict[str, float] = evaluate(result, clip, masks, wanted=wanted).metrics
    return metrics
