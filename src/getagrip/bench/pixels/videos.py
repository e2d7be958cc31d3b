"""``getagrip bench video``: drafts of rendered videos: the error of each stage, oracles in their place, ablations."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from getagrip.batch.freshness import load_or_compute, software_of_method
from getagrip.bench.ablations import ABLATIONS, Ablation
from getagrip.bench.inputs.perturbations import UNCHANGED
from getagrip.bench.job import Benchmark, BenchmarkPage, ClipScores, Trial
from getagrip.bench.pixels.video_draft import ORACLES, Oracle, VideoDraft
from getagrip.bench.sources import Sample
from getagrip.bench.sources.rendered_videos import RenderedVideos
from getagrip.checks.calibration import MAX_ROTATION_DEG, MAX_SHARE_ACROSS
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import markdown_page, print_note
from getagrip.studio.hands.networks import Nets, load_models
from getagrip.studio.jobs import RunCall
from getagrip.synthetic.filmed import (
    FILM_FPS,
    GRASP_FRAMES,
    REACH_FRAMES,
    FilmedClip,
    draw_look,
    make_filmed_scene,
    read_scan,
)
from getagrip.synthetic.video import VIDEO_FILE, write_rendered_video

VIDEO_CODE = ("bench", "studio", "synthetic", "readers", "cli")
"""Code, besides a reconstruction's, that a record depends on."""
PLAIN = "draft"
"""Name, in tables and records, of the draft without an oracle."""
STAGE_HEADINGS = (
    "split", "videos", "hand found, %", "side right, %", "landmarks, % of hand", "joints, mm", "along ray, mm",
    "palm, deg", "tilt, deg", "first mask, IOU", "masks, IOU", "interval off, frames", "right kept, %",
    "right first, %", "said, %", "Brier", "CPU s",
)  # fmt: skip
ORACLE_HEADINGS = (
    "split", "truth in place of", "videos", "no result", "ADD, % of diameter", "right, %", "rotation, deg",
    "along ray, mm", "across ray, mm", "masks, IOU", "right but for distance, %", "interval holds, %",
)  # fmt: skip
ABLATION_HEADINGS = (
    "split", "setting", "videos", "no result", "right, %", "right but for distance, %", "gained", "lost",
    "rotation, deg", "IOU", "scans", "facing right, %", "CPU of the fit", "CPU of the draft",
)  # fmt: skip
MAX_TURNED_DEG = 45.0
"""Rotation, symmetries of the shape not counted, below which a textured object faces as it truly does [degrees]."""


@dataclass(frozen=True)
class VideoScores(ClipScores):
    """The record of a video: errors of the stages, and of the results by oracle."""

    split: str = ""
    stages: Json = field(default_factory=dict)
    by: Mapping[str, Json] = field(default_factory=dict)
    scanned: bool = False
    """True for a textured scan."""
    seconds: float = 0.0
    """CPU time of rendering, stages and fit, without oracles and settings [s]."""


@dataclass(frozen=True)
class VideoTrial(Trial[VideoScores]):
    """A video to draft; its record goes into ``results``."""

    filmed: FilmedClip
    oracles: tuple[str, ...]
    options: Options
    models: Path | None
    run: RunCall
    settings: Mapping[str, Options] = field(default_factory=dict)
    """Options of an ablation's settings, by label."""

    def failed(self, why: str, trace: str = "") -> VideoScores:
        return VideoScores(self.name, failure=why, trace=trace, split=self.filmed.split)

    def scores(self) -> VideoScores:
        filmed, scan, nets = asdict(self.filmed), self.filmed.scan, open_networks(self.models)
        if scan is not None:
            mesh = read_scan(scan)
            assert mesh.colours is not None
            filmed["scan"] = sha256(mesh.vertices.tobytes() + mesh.colours.tobytes()).hexdigest()
        of = {
            "inputs": {
                "filmed": filmed,
                "oracles": self.oracles,
                "simulated": nets is None,
                "settings": {label: asdict(options) for label, options in self.settings.items()},
            },
            "options": asdict(self.options),
            "software": software_of_method(self.options.method, *VIDEO_CODE),
        }
        path = self.results / f"{self.name}.json"
        record, again = load_or_compute(path, of, self.overwrite, partial(_draft, self, nets))
        return VideoScores(
            self.name, again=again, split=self.filmed.split, stages=record["stages"], by=record["by"],
            scanned=scan is not None, seconds=record["seconds"],
        )  # fmt: skip


def open_networks(models: Path | None) -> Nets | None:
    """Open the networks that find hands; None where no folder is stated and they are not installed.

    Raises ``InputError`` for a stated folder without them.
    """
    try:
        return load_models(models)
    except InputError:
        if models is not None:
            raise
        return None


def _draft(trial: VideoTrial, nets: Nets | None) -> Json:
    """Render a video, draft it without and with oracles, or in each setting; return the content of its record."""
    since, filmed = time.process_time(), trial.filmed
    scene, colours = make_filmed_scene(filmed)
    folder = trial.sample.folder
    look = draw_look(filmed.split, filmed.seed, colours)
    write_rendered_video(scene, folder, filmed.seed, size=scene.clip.size, look=look, overwrite=True)
    rendered = time.process_time() - since
    with TemporaryDirectory() as made:
        draft = VideoDraft(filmed, scene, folder / VIDEO_FILE, Path(made), nets, trial.run)
        by = {PLAIN: draft.solve(Oracle(), trial.options)}
        seconds = time.process_time() - since
        by |= {name: draft.solve(ORACLES[name], trial.options) for name in trial.oracles}
        for label, options in trial.settings.items():
            by[label] = by[PLAIN] if options == trial.options else draft.solve(Oracle(), options)
    return {"split": filmed.split, "stages": draft.stages | {"render_seconds": rendered}, "by": by, "seconds": seconds}


@dataclass(frozen=True)
class VideoBenchmark(Benchmark[VideoScores]):
    """A benchmark that drafts every video, without and with oracles, or in the settings of an ablation.

    Raises ``UsageError`` for an unknown oracle or ablation, and for one that changes more than options.
    """

    source: RenderedVideos
    options: Options
    oracles: tuple[str, ...]
    run: RunCall
    ablation: str | None = None

    def __post_init__(self) -> None:
        for name in self.oracles:
            if name not in ORACLES:
                raise unknown_choice_error("--oracle", name, ORACLES)
        of_options = [name for name, ablation in ABLATIONS.items() if _changes_options_only(ablation)]
        if self.ablation is not None and self.ablation not in of_options:
            raise unknown_choice_error("--ablation", self.ablation, of_options)
        if self.ablation is not None and self.oracles:
            raise UsageError("--ablation cannot be used with --oracle")

    @property
    def settings(self) -> dict[str, Options]:
        """Options of each setting to compare, by label."""
        of = () if self.ablation is None else ABLATIONS[self.ablation].settings
        return {setting.label: replace(self.options, **setting.options) for setting in of}

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[VideoScores]]:
        filmed = {clip.name: clip for clip in self.source.filmed()}
        models, oracles = self.source.models, tuple(dict.fromkeys(self.oracles))
        if open_networks(models) is None:
            print_note("the networks that find hands are absent: landmarks are simulated by errors on real images")
        folder = results if self.ablation is None else files.folder_inside(results, self.ablation)
        return [
            VideoTrial(
                sample, folder, overwrite, filmed[sample.name], oracles, self.options, models, self.run, self.settings
            )
            for sample in samples
        ]

    def page(self, scores: Sequence[VideoScores]) -> BenchmarkPage | None:
        done = [one for one in scores if not one.failure]
        if not done:
            return None
        splits = [split for split in ("train", "validation") if any(one.split == split for one in done)]
        parts = [(split, [one for one in done if one.split == split]) for split in splits]
        content = {one.name: {"split": one.split, "stages": one.stages, "by": one.by} for one in done}
        if self.ablation is not None:
            text = _ablation_page(ABLATIONS[self.ablation], parts)
            return BenchmarkPage("", text, {f"{self.ablation}.md": text}, {}, content)
        stages = [STAGE_HEADINGS, *(_stage_row(*part) for part in parts)]
        variants = (PLAIN, *dict.fromkeys(self.oracles))
        oracles = [ORACLE_HEADINGS, *(_oracle_row(*part, name) for part in parts for name in variants)]
        simulated = any(one.stages.get("simulated") for one in done)
        about = [
            f"rendered videos of {2 * REACH_FRAMES + GRASP_FRAMES} frames, {FILM_FPS:g} a second; medians over videos, "
            "in the camera; right: mean ADD, up to symmetries, below 10 % of the diameter; no result counts as wrong",
            *["landmarks are simulated: the networks were absent"] * simulated,
            "along ray: of the joints' middle, of the object's centre; absolute values for the object",
            f"right but for distance: rotation within {MAX_ROTATION_DEG:g} degrees, across the ray within "
            f"{100.0 * MAX_SHARE_ACROSS:g} % of the diameter; interval holds: the result's interval of its distance "
            "from the camera, of 90 %",
            "interval off: mean distance of first and last frame from the true ones",
            "right kept, first: a kept candidate is right, the result is; said: mean probability in the camera; Brier: "
            "its score",
            f"made {date_and_commit()}",
        ]
        texts = {
            "stages.md": markdown_page("Stages of rendered videos", stages, about),
            "oracles.md": markdown_page("Rendered videos with the truth in place of a stage", oracles, about, 2),
        }
        return BenchmarkPage("", "\n".join(texts.values()), texts, {}, content)


def _median(values: Sequence[float | None], form: str = ".0f") -> str:
    known = [value for value in values if value is not None and np.isfinite(value)]
    return format(float(np.median(known)), form) if known else "–"


def _mean(values: Sequence[float | bool | None], form: str = ".0f", factor: float = 100.0) -> str:
    known = [float(value) for value in values if value is not None]
    return format(factor * float(np.mean(known)), form) if known else "–"


def _right(one: VideoScores, name: str, kept: bool = False) -> bool:
    found = one.by[name]
    if "failure" in found:
        return False
    return any(each["right"] for each in found["candidates"]) if kept else bool(found["object"]["right"])


def is_right_in_image(errors: Json) -> bool:
    """Return whether an object with some ``ObjectErrors`` is right but for its distance and size."""
    diameter = 100.0 * errors["add_mm"] / errors["add_percent"]
    return bool(errors["rotation_deg"] < MAX_ROTATION_DEG and errors["across_mm"] < MAX_SHARE_ACROSS * diameter)


def interval_holds(found: Json) -> bool | None:
    """Return whether the interval of a result's distance holds the true one; None where it states none."""
    interval = found.get("said", {}).get("distance_interval_mm")
    return None if interval is None else bool(interval[0] <= found["distance_mm"] <= interval[1])


def _stage_row(split: str, scores: Sequence[VideoScores]) -> list[str]:
    stages, results = [one.stages for one in scores], [one.by[PLAIN] for one in scores]
    lifted = [stage.get("lifted") or {} for stage in stages]
    ends = [stage.get("interval_off") for stage in stages]
    said = [result.get("said", {}).get("in_camera") for result in results]
    brier = [(p - _right(one, PLAIN)) ** 2 for p, one in zip(said, scores, strict=True) if p is not None]
    return [
        split,
        f"{len(scores)}",
        _mean([stage.get("hand_found", 0.0) for stage in stages]),
        _mean([stage.get("side_right") for stage in stages]),
        _median([100.0 * stage["landmarks_off"] if "landmarks_off" in stage else None for stage in stages], ".1f"),
        *(_median([hand.get(key) for hand in lifted]) for key in ("joints_mm", "along_mm", "palm_deg", "tilt_deg")),
        _median([stage.get("first_mask_iou") for stage in stages], ".2f"),
        _median([stage.get("masks_iou") for stage in stages], ".2f"),
        _mean([None if end is None else float(np.mean(np.abs(end))) for end in ends], ".1f", 1.0),
        _mean([_right(one, PLAIN, kept=True) for one in scores]),
        _mean([_right(one, PLAIN) for one in scores]),
        _mean(said),
        _mean(brier, ".2f", 1.0),
        _median([one.seconds for one in scores]),
    ]


def _oracle_row(split: str, scores: Sequence[VideoScores], name: str) -> list[str]:
    results = [one.by[name] for one in scores]
    made = [result["object"] for result in results if "failure" not in result]
    return [
        split,
        "nothing" if name == PLAIN else name,
        f"{len(scores)}",
        f"{len(results) - len(made)}",
        _median([each["add_percent"] for each in made]),
        _mean([_right(one, name) for one in scores]),
        _median([each["rotation_deg"] for each in made]),
        _median([abs(each["along_mm"]) for each in made]),
        _median([each["across_mm"] for each in made], ".1f"),
        _median([result.get("mask_iou") for result in results], ".2f"),
        _mean(["failure" not in result and is_right_in_image(result["object"]) for result in results]),
        _mean([interval_holds(result) for result in results]),
    ]


def _changes_options_only(ablation: Ablation) -> bool:
    """Return whether all settings of an ablation are options of the method of drafts."""
    own = "soft-hinge" in ablation.methods and ablation.usual is not None
    return own and all(one.change == UNCHANGED and one.contact is None for one in ablation.settings)


def _ablation_page(ablation: Ablation, parts: Sequence[tuple[str, Sequence[VideoScores]]]) -> str:
    """Write the page of an ablation: a row for each setting in each split."""
    assert ablation.usual is not None
    labels = [setting.label for setting in ablation.settings]
    rows = [_ablation_row(*part, label, ablation.usual) for part in parts for label in labels]
    about = [
        "drafts of rendered videos, the same hands and masks in all settings; no result counts as wrong",
        "right: mean ADD, up to symmetries, below 10 % of the diameter, in the camera; but for distance: rotation "
        f"within {MAX_ROTATION_DEG:g} degrees, across the ray within {100.0 * MAX_SHARE_ACROSS:g} % of the diameter",
        f"gained, lost: videos right but for distance unlike by '{ablation.usual}'; medians of rotation, and of IOU "
        "with the draft's masks",
        f"facing right: textured scans that are turned by less than {MAX_TURNED_DEG:g} degrees, symmetries of "
        "the shape not counted",
        f"CPU: sum over videos, as a multiple of '{ablation.usual}'; the draft's without rendering",
        f"made {date_and_commit()}",
    ]
    return markdown_page(ablation.title, [ABLATION_HEADINGS, *rows], about, 2)


def _ablation_row(split: str, scores: Sequence[VideoScores], label: str, usual: str) -> list[str]:
    results = [one.by[label] for one in scores]
    made = [result for result in results if "failure" not in result]
    pairs = [(one.by[label], one.by[usual]) for one in scores]
    right = [tuple("failure" not in each and is_right_in_image(each["object"]) for each in pair) for pair in pairs]
    scans = [one.by[label] for one in scores if one.scanned]
    facing = ["failure" not in one and one["object"]["turned_deg"] < MAX_TURNED_DEG for one in scans]
    return [
        split,
        label,
        f"{len(scores)}",
        f"{len(results) - len(made)}",
        _mean([_right(one, label) for one in scores]),
        _mean([here for here, _ in right]),
        f"{right.count((True, False))}",
        f"{right.count((False, True))}",
        _median([result["object"]["rotation_deg"] for result in made], ".1f"),
        _median([result["iou"] for result in made], ".3f"),
        f"{len(scans)}",
        _mean(facing),
        *_cpu_ratios(scores, label, usual),
    ]


def _cpu_ratios(scores: Sequence[VideoScores], label: str, usual: str) -> tuple[str, str]:
    """Return the CPU time of a setting's fits as a multiple of the usual one's, and the same of whole drafts."""
    done = [one for one in scores if all("fit_seconds" in one.by[name] for name in (PLAIN, label, usual))]
    plain, here, there = (sum(one.by[name]["fit_seconds"] for one in done) for name in (PLAIN, label, usual))
    before = sum(one.seconds - one.stages["render_seconds"] for one in done) - plain
    return (f"{here / there:.2f}", f"{(before + here) / (before + there):.2f}") if done else ("–", "–")
