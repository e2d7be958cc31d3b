"""``getagrip bench dexycb-timelines``, ``hot3d-timelines``: reconstruct timelines from their true segments.

Every variant runs at every level of noise; poses, jumps between segments and contact are scored.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Required, TypedDict

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.batch.freshness import load_or_compute, provenance_of
from getagrip.bench.comparison import estimate_mean
from getagrip.bench.job import Benchmark, BenchmarkPage, ClipScores, Trial
from getagrip.bench.sources import Sample
from getagrip.bench.sources.recorded import TimelineSource
from getagrip.clip import Clip, read_clip, read_masks
from getagrip.errors import GetagripError, UsageError
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import format_count, markdown_page
from getagrip.metrics.contact import ContactDefinition, contact_distances, stable_contact
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import Symmetries, find_symmetries
from getagrip.readers.datasets.tracks import subject_from_clip_name
from getagrip.synthetic.noise import NOISE_PRESETS, Noise, perturbed

TIMELINE_NOISE_LEVELS: dict[str, Noise] = {
    "exact": Noise(),
    "moderate": replace(NOISE_PRESETS["moderate"], mask_ragged_px=0.0),
    "strong": replace(NOISE_PRESETS["strong"], mask_ragged_px=0.0),
    "ragged": NOISE_PRESETS["strong"],
}
"""Noise of hands; ``ragged`` adds noise of masks, 1 px, to strong noise of hands."""
TIMELINE_CODE = ("bench/sequences/timelines.py",)
"""Code, besides a reconstruction's, that scores depend on."""
ALL_NOISE_LEVELS = "all"
"""Value of ``--preset`` for all levels in turn."""
TIMELINE_CONTACT_DEFINITION = ContactDefinition("object", 0.010)
SEGMENT_KINDS = {"static": "static", "contact": "between", "free": "between", "grasp": "grasp"}
"""Names of segments in tables, by state."""
TIMELINE_TABLE_HEADINGS = (
    "hands", "", "static", "between", "grasp", "grasp, ADD", "mugs, grasp", "jump, mm", "SCA", "s",
)  # fmt: skip


class VariantScores(TypedDict, total=False):
    """The scores of a variant on a timeline, as its record holds them."""

    seconds: Required[float]
    """CPU time [s]."""
    segments: Sequence[Json]
    """The ``SegmentScore`` of each segment."""
    jumps: Sequence[float]
    """Jump from each segment to the next [m]."""
    failure: str
    """Reason for missing segments and jumps."""


@dataclass(frozen=True)
class TimelineScores(ClipScores):
    """The scores of a timeline."""

    category: str = ""
    by: Mapping[str, Mapping[str, VariantScores]] = field(default_factory=dict)
    """Scores by level and variant."""


@dataclass(frozen=True)
class TimelineTrial(Trial[TimelineScores]):
    """A timeline to reconstruct; its records go to ``results/<level>/<name>.json``."""

    levels: tuple[str, ...]
    """Keys of ``TIMELINE_NOISE_LEVELS``."""
    options: Options

    def failed(self, why: str, trace: str = "") -> TimelineScores:
        return TimelineScores(self.name, failure=why, trace=trace)

    def scores(self) -> TimelineScores:
        by, category = dict[str, Mapping[str, VariantScores]](), ""
        of, again = provenance_of(self.sample.folder, self.options, *TIMELINE_CODE), dict[str, None]()
        for level in self.levels:
            path = self.results / level / f"{self.name}.json"
            record, why = load_or_compute(path, of, self.overwrite, partial(_score_noise_level, self, level))
            again |= {why: None} if why else {}
            category = record["category"]
            if record["by"]:
                by[level] = record["by"]
        return TimelineScores(self.name, category, by, again="; ".join(again))


def _score_noise_level(trial: TimelineTrial, level: str) -> Json:
    """Return the scores of every variant at a level; empty for timelines without a static segment or a grasp."""
    from getagrip.timelines.variants import TIMELINE_VARIANTS, reconstruct_variant

    tracked = read_clip(trial.sample.folder)
    input_masks = read_masks(tracked)
    states = {segment.state for segment in tracked.segments}
    by: dict[str, VariantScores] = {}
    if not {"static", "grasp"} <= states:
        return {"category": tracked.category, "by": by}
    symmetries = find_symmetries(tracked.mesh)
    seed = [trial.options.seed, *tracked.name.encode()]
    clip, masks = perturbed(tracked, input_masks, TIMELINE_NOISE_LEVELS[level], seed)
    for variant in TIMELINE_VARIANTS:
        since = time.process_time()
        try:
            motion = reconstruct_variant(variant, clip, masks, trial.options)
        except GetagripError as error:
            by[variant] = {"failure": str(error), "seconds": time.process_time() - since}
            continue
        by[variant] = {
            "seconds": time.process_time() - since,
            "segments": [asdict(s) for s in segment_scores(clip, symmetries, motion.T_cam_obj, motion.T_cam_hand)],
            "jumps": segment_jumps(clip, motion.T_cam_obj),
        }
    return {"category": tracked.category, "by": by}


@dataclass(frozen=True)
class SegmentScore:
    """The score of a segment's poses in the camera frame.

    Attributes:
        kind: value of ``SEGMENT_KINDS``.
        right: whether the mean ADD is below a tenth of the diameter.
        right_sym: whether the mean ADD up to the object's symmetries is.
        add_sym: mean ADD up to symmetries, in diameters.
        sca: stable contact area of a grasp, else None.
    """

    kind: str
    right: bool
    right_sym: bool
    add_sym: float
    sca: float | None


def segment_scores(
    clip: Clip, symmetries: Symmetries, T_cam_obj: Float[ndarray, "T 4 4"], T_cam_hand: Float[ndarray, "T 4 4"]
) -> list[SegmentScore]:
    """Score each segment of a clip with ground truth and known scale; contact is with the result's hand."""
    assert clip.truth is not None
    out = []
    for segment in clip.segments:
        rows = segment.rows
        found, true = ObjectTrack(T_cam_obj[rows], 1.0), ObjectTrack(clip.truth.T_cam_obj[rows], clip.truth.scale)
        plain = pose_errors(clip.mesh, found, true)
        sym = pose_errors(clip.mesh, found, true, best_symmetry(clip.mesh, found, true, symmetries))
        sca = None
        if segment.state == "grasp":
            grasped = ObjectTrack(se3.inverse(T_cam_hand[rows]) @ T_cam_obj[rows], 1.0)
            (distances,) = contact_distances(clip.mesh, [grasped], clip.hand.vertices[rows], clip.hand.faces)
            sca = stable_contact(distances, TIMELINE_CONTACT_DEFINITION).sca
        share = float(sym.add.mean() / sym.diameter)
        out.append(SegmentScore(SEGMENT_KINDS[segment.state], plain.success, sym.success, share, sca))
    return out


def segment_jumps(clip: Clip, T_cam_obj: Float[ndarray, "T 4 4"]) -> Sequence[float]:
    """Measure the object's jump from each segment to the next beyond its true motion, mean over vertices [m]."""
    assert clip.truth is not None
    out = []
    for one, other in zip(clip.segments, clip.segments[1:], strict=False):
        moves = [T[other.first] @ se3.inverse(T[one.last]) for T in (T_cam_obj, clip.truth.T_cam_obj)]
        posed = se3.transform(clip.truth.T_cam_obj[one.last], clip.truth.scale * clip.mesh.vertices)
        apart = se3.transform(moves[0], posed) - se3.transform(moves[1], posed)
        out.append(float(np.linalg.norm(apart, axis=1).mean()))
    return out


@dataclass(frozen=True)
class TimelineBenchmark(Benchmark[TimelineScores]):
    """A benchmark that reconstructs every timeline with every variant."""

    source: TimelineSource
    options: Options

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[TimelineScores]]:
        preset = self.source.preset
        levels = tuple(TIMELINE_NOISE_LEVELS) if preset == ALL_NOISE_LEVELS else (preset,)
        for level in levels:
            files.folder_inside(results, level)
        return [TimelineTrial(sample, results, overwrite, levels, self.options) for sample in samples]

    def page(self, scores: Sequence[TimelineScores]) -> BenchmarkPage | None:
        """Make the page. Raises ``UsageError`` where no timeline has both a static segment and a stable grasp."""
        done = [one for one in scores if not one.failure]
        whole = [one for one in done if one.by]
        if done and not whole:
            lacking = "a timeline with both a static segment and a stable grasp"
            count = format_count(len(done), "timeline")
            raise UsageError(f"missing {lacking} in {self.source.dataset}: none of {count}")
        if not whole:
            return None
        grid: list[Sequence[str]] = [TIMELINE_TABLE_HEADINGS]
        grid += [
            (level, variant, *_timeline_cells(whole, level, variant))
            for level, variants in whole[0].by.items()
            for variant in variants
        ]
        about = [
            f"{self.source.title}: {len(whole)} of {len(done)} sequences, those with a static segment and a stable "
            "grasp",
            "static, between, grasp: per cent of segments whose mean ADD up to symmetries, in the camera frame, is "
            "below 10 % of the diameter; grasp, ADD: without symmetries; a variant that fails scores 0",
            "hands: exact, moderate and strong noise, masks exact; ragged: strong noise, and masks off by 1 px",
            "jump: median over links of how far the object moves from one segment to the next beyond its true motion",
            "SCA: mean over grasps, object vertices within 10 mm of the reconstructed hand",
            "s: median seconds of CPU for a timeline, reading not included",
            "in brackets: 95 % intervals by Student's t over the subjects",
            f"{self.options.inits} initial poses, seed {self.options.seed}; made {date_and_commit()}",
        ]
        text = markdown_page("Timelines", grid, about, words=2)
        return BenchmarkPage(self.source.preset, text, {".md": text}, {}, {one.name: one.by for one in whole})


def _timeline_cells(scores: Sequence[TimelineScores], level: str, variant: str) -> list[str]:
    known = [(one, one.by[level][variant]) for one in scores]
    cells = [_segment_percentage(known, kind, "right_sym") for kind in ("static", "between", "grasp")]
    cells.append(_segment_percentage(known, "grasp", "right"))
    cells.append(_segment_percentage([pair for pair in known if "mug" in pair[0].category], "grasp", "right_sym"))
    gaps = [jump for _, score in known for jump in score.get("jumps", [])]
    sca = [s["sca"] for _, score in known for s in score.get("segments", []) if s["sca"] is not None]
    cells += [f"{1e3 * np.median(gaps):.1f}" if gaps else "–", f"{100 * np.mean(sca):.1f}" if sca else "–"]
    return [*cells, f"{np.median([score['seconds'] for _, score in known]):.1f}"]


def _segment_percentage(known: Sequence[tuple[TimelineScores, VariantScores]], kind: str, key: str) -> str:
    """Format the share of right segments of a kind, with an interval; a failed timeline counts as a wrong segment."""
    values, subjects = [], []
    for one, score in known:
        right = [float(s[key]) for s in score["segments"] if s["kind"] == kind] if "segments" in score else [0.0]
        values += right
        subjects += [subject_from_clip_name(one.name)] * len(right)
    if not values:
        return "–"
    value = estimate_mean(np.array(values), subjects)
    interval = "" if np.isnan(value.low) else f" [{100 * value.low:.0f}, {100 * value.high:.0f}]"
    return f"{100 * value.mean:.1f}{interval} (n = {value.clips})"
