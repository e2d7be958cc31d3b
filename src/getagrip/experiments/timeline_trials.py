"""One timeline of a benchmark, reconstructed every way at every level of noise."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

from getagrip.clip import read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE, Noise, perturbed
from getagrip.errors import GetagripError
from getagrip.experiments.records import kept_or_made, made_of
from getagrip.experiments.timeline_scores import jumps, segment_scores
from getagrip.experiments.trial import ClipScores, Trial
from getagrip.fitting.options import Options
from getagrip.metrics.symmetry import find_symmetries

LEVELS: dict[str, Noise] = {
    "exact": Noise(),
    "moderate": replace(NOISE["moderate"], mask_ragged_px=0.0),
    "strong": replace(NOISE["strong"], mask_ragged_px=0.0),
    "ragged": NOISE["strong"],
}
"""Noise of hands; ``ragged`` is strong noise, and that of masks, too: 1 px."""
CODE = ("experiments/timeline_scores.py", "experiments/timeline_trials.py")
"""Code that scores depend on, besides that of a reconstruction."""
ALL = "all"
"""All levels, one after the other."""


@dataclass(frozen=True)
class TimelineScores(ClipScores):
    """The scores of a timeline."""

    category: str = ""
    by: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By level and way: ``segments``, ``jumps`` [m] and ``seconds`` of CPU, or ``failure``."""
    again: str = ""
    """Why it was made again, where what was there is no longer good."""


@dataclass(frozen=True)
class TimelineTrial(Trial[TimelineScores]):
    """A timeline to reconstruct; a folder for each level, with a file for it, goes into ``results``."""

    levels: tuple[str, ...]
    """Keys of ``LEVELS``."""
    options: Options

    def failed(self, why: str, trace: str = "") -> TimelineScores:
        return TimelineScores(self.name, failure=why, trace=trace)

    def scores(self) -> TimelineScores:
        by, category = dict[str, Any](), ""
        of, again = made_of(self.sample.folder, self.options, *CODE), dict[str, None]()
        for level in self.levels:
            path = self.results / level / f"{self.name}.json"
            record, why = kept_or_made(path, of, self.overwrite, partial(_found, self, level))
            again |= {why: None} if why else {}
            category = record["category"]
            if record["by"]:
                by[level] = record["by"]
        return TimelineScores(self.name, category, by, "; ".join(again))


def _found(trial: TimelineTrial, level: str) -> dict[str, Any]:
    """Return the scores of every variant at a level, for timelines with both a static segment and a grasp."""
    from getagrip.timelines.baselines import VARIANTS, reconstruct_with

    tracked = read_clip(trial.sample.folder)
    input_masks = read_masks(tracked)
    states = {segment.state for segment in tracked.segments}
    by: dict[str, dict[str, Any]] = {}
    if not {"static", "grasp"} <= states:
        return {"category": tracked.category, "by": by}
    symmetries = find_symmetries(tracked.mesh)
    clip, masks = perturbed(tracked, input_masks, LEVELS[level], [trial.options.seed, *tracked.name.encode()])
    for variant in VARIANTS:
        since = time.process_time()
        try:
            motion = reconstruct_with(variant, clip, masks, trial.options)
        except GetagripError as error:
            by[variant] = {"failure": str(error), "seconds": time.process_time() - since}
            continue
        by[variant] = {
            "seconds": time.process_time() - since,
            "segments": [asdict(s) for s in segment_scores(clip, symmetries, motion.T_cam_obj, motion.T_cam_hand)],
            "jumps": jumps(clip, motion.T_cam_obj),
        }
    return {"category": tracked.category, "by": by}
