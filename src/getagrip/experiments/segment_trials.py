"""One sequence of a benchmark of segments: its grasps found without its truth, forwards and in reverse."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import numpy as np

from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE, perturbed
from getagrip.experiments.records import kept_or_made, made_of
from getagrip.experiments.segment_scores import Matched, Span, matched
from getagrip.experiments.trial import ClipScores, Trial
from getagrip.fitting.options import Options
from getagrip.grasps.definition import Definition
from getagrip.io.files import Json

DIRECTIONS = ("forwards", "in reverse")
DEFINITION = Definition(contact=0.010)
"""Definition of a stable grasp, as that of the truth (``datasets.dexycb.reader``)."""
VARIANTS = {"fits": "fits and Eq. 2", "motion": "first to last motion"}
"""How grasps are found: ours; and what the image motion alone says, with no fit."""
CODE = ("segmentation", "experiments/segment_trials.py")
"""Code that what is found depends on, besides that of a reconstruction."""


@dataclass(frozen=True)
class SequenceScores(ClipScores):
    """The scores of a sequence."""

    by: dict[tuple[str, str], Matched] = field(default_factory=dict)
    """By direction and way; empty where it failed."""
    seconds: float = 0.0
    """Time of the process for one direction [s]; the mean of both."""
    again: str = ""
    """Why it was made again, where what was there is no longer good."""


@dataclass(frozen=True)
class SequenceTrial(Trial[SequenceScores]):
    """A sequence to find the grasps of; a file for it goes into ``results``."""

    noise: str
    """Key of ``NOISE``: the noise of hands and masks."""
    options: Options

    def failed(self, why: str, trace: str = "") -> SequenceScores:
        return SequenceScores(self.name, failure=why, trace=trace)

    def scores(self) -> SequenceScores:
        by, seconds = {}, []
        of = made_of(self.sample.folder, self.options, *CODE)
        record, again = kept_or_made(self.results / f"{self.name}.json", of, self.overwrite, partial(_found, self))
        for direction in DIRECTIONS:
            here = record[direction]
            seconds.append(float(here["seconds"]))
            for variant in VARIANTS:
                by[direction, variant] = matched(_spans(here["true"]), _spans(here[variant]))
        return SequenceScores(self.name, by, float(np.mean(seconds)), again)


def reversed_in_time(clip: Clip, masks: Masks) -> tuple[Clip, Masks]:
    """Reverse a clip in time; its truth goes with it, its segments do not."""
    index = np.arange(len(clip))[::-1]
    back = clip.take(index)
    return replace(back, frames=clip.frames, times=None, segments=(), name=f"{clip.name}--reversed"), masks.take(index)


def mirrored(spans: list[Span], frames: int) -> list[Span]:
    """Return the intervals of a sequence, in its reverse."""
    return [(frames - 1 - last, frames - 1 - first) for first, last in reversed(spans)]


def _found(trial: SequenceTrial) -> Json:
    """Return the true and the found segments, by direction."""
    from getagrip.segmentation.found import find_segments, moving_runs

    clip = read_clip(trial.sample.folder)
    masks = read_masks(clip)
    true = [(s.first, s.last) for s in clip.segments if s.state == "grasp"]
    clip, masks = perturbed(clip, masks, NOISE[trial.noise], [0, *clip.name.encode()])
    out = {}
    for direction in DIRECTIONS:
        if direction == "in reverse":
            (clip, masks), true = reversed_in_time(clip, masks), mirrored(true, len(clip))
        since = time.process_time()
        found = find_segments(clip, masks, DEFINITION, trial.options)
        seconds = time.process_time() - since
        runs = [run for run in moving_runs(clip, masks) if run[1] + 1 - run[0] >= DEFINITION.shortest]
        whole = [(min(first for first, _ in runs), max(last for _, last in runs))] if runs else []
        out[direction] = {
            "true": true,
            "fits": found.grasps,
            "motion": whole,
            "segments": [asdict(one) for one in found.segments],
            "seconds": seconds,
        }
    return out


def _spans(value: list[list[int]]) -> list[Span]:
    return [(first, last) for first, last in value]
