"""One timeline of a benchmark, reconstructed every way at every level of noise."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from getagrip.batch.job import failure
from getagrip.clip import read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE, Noise, perturbed
from getagrip.errors import GetagripError
from getagrip.experiments.records import kept_or_made, made_of
from getagrip.experiments.sources import Sample
from getagrip.experiments.timeline_scores import jumps, segment_scores
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
class TimelineTrial:
    """A timeline to reconstruct."""

    sample: Sample
    levels: tuple[str, ...]
    """Of ``LEVELS``."""
    options: Options
    results: Path
    """A folder for each level, with a file for each timeline, goes here."""
    overwrite: bool

    @property
    def name(self) -> str:
        """The timeline's."""
        return self.sample.name


@dataclass(frozen=True)
class TimelineScores:
    """What was found."""

    name: str
    category: str = ""
    by: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By level and way: ``segments``, ``jumps`` [m] and ``seconds`` of CPU, or ``failure``."""
    failure: str = ""
    trace: str = ""
    again: str = ""
    """Why it was made again, where what was there is no longer good."""


def run_timeline(trial: TimelineTrial) -> TimelineScores:
    """Reconstruct one timeline, as far as that has not been done by the same code. Raises nothing."""
    try:
        return _run(trial)
    except Exception as error:  # one timeline's trouble must not end the others
        outcome = failure(trial.sample.name, error)
        return TimelineScores(trial.sample.name, failure=outcome.message, trace=outcome.trace)


def _run(trial: TimelineTrial) -> TimelineScores:
    sample, by, category = trial.sample, dict[str, Any](), ""
    of, again = made_of(sample.folder, trial.options, *CODE), dict[str, None]()
    for level in trial.levels:
        path = trial.results / level / f"{sample.name}.json"
        record, why = kept_or_made(path, of, trial.overwrite, partial(_found, trial, level))
        again |= {why: None} if why else {}
        category = record["category"]
        if record["by"]:
            by[level] = record["by"]
    return TimelineScores(sample.name, category, by, again="; ".join(again))


def _found(trial: TimelineTrial, level: str) -> dict[str, Any]:
    """The scores of every way at a level; of timelines that hold both a static segment and a grasp."""
    from getagrip.timelines.ways import WAYS, moved

    given = read_clip(trial.sample.folder)
    given_masks = read_masks(given)
    states = {segment.state for segment in given.segments}
    by: dict[str, dict[str, Any]] = {}
    if not {"static", "grasp"} <= states:
        return {"category": given.category, "by": by}
    symmetries = find_symmetries(given.mesh)
    clip, masks = perturbed(given, given_masks, LEVELS[level], [trial.options.seed, *given.name.encode()])
    for way in WAYS:
        since = time.process_time()
        try:
            motion = moved(way, clip, masks, trial.options)
        except GetagripError as error:
            by[way] = {"failure": str(error), "seconds": time.process_time() - since}
            continue
        by[way] = {
            "seconds": time.process_time() - since,
            "segments": [asdict(s) for s in segment_scores(clip, symmetries, motion.T_cam_obj, motion.T_cam_hand)],
            "jumps": jumps(clip, motion.T_cam_obj),
        }
    return {"category": given.category, "by": by}
