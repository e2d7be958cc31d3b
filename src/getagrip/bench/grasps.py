"""``getagrip bench`` on clips of grasps: every clip in every variant, then tables and, for an ablation, a plot.

Each result is a folder with its metrics in ``result.json``, which other commands can read; valid results are kept.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np

from getagrip.batch.freshness import software_of_method, valid_result
from getagrip.batch.job import Outcome, failed_outcome
from getagrip.batch.ledger import LedgerEntry
from getagrip.bench.ablations import (
    ABLATIONS,
    REFERENCE_METHOD,
    Ablation,
    Variant,
    ablation_variants,
    by_contact,
    hand_source_ablation,
    method_variants,
    view_ablation,
)
from getagrip.bench.comparison import GraspClipScores, GraspVariantScore, compare_variants, independent_groups
from getagrip.bench.inputs.hand_sources import HandSource
from getagrip.bench.inputs.perturbations import UNCHANGED
from getagrip.bench.job import Benchmark, BenchmarkPage, Trial
from getagrip.bench.options import ComparisonOptions
from getagrip.bench.sources import ClipSource, Sample
from getagrip.bench.tables import (
    clips_csv_rows,
    comparison_csv_rows,
    comparison_json,
    comparison_latex,
    comparison_markdown,
    published_markdown,
    terminal_table,
)
from getagrip.clip import Clip, Masks, input_sha256, observed_frames, read_clip, read_masks
from getagrip.clip.clip import frame_indices
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.fitting.methods import METHODS, method_of
from getagrip.fitting.options import FREE_SCALE_START_FACTOR, Options, PriorsFile
from getagrip.io import files, plugins
from getagrip.io.files import Json, is_portable_name, sha256
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import format_count
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition, contact_definitions_at
from getagrip.metrics.evaluate.comparison import write_result_hands
from getagrip.metrics.evaluate.external import ExternalSystem
from getagrip.metrics.evaluate.metric import ADD_SYM, ADD_SYM_CAM, METRICS, REPLAY_STABILITY, SCA
from getagrip.result import Reconstruction, read_result_record, software_versions, write_result
from getagrip.result.findings import read_findings, read_probability


def system_of(text: str) -> ExternalSystem:
    """Parse ``NAME=FOLDER``. Raises ``UsageError``."""
    name, equals, folder = text.partition("=")
    if not (equals and folder and is_portable_name(name)):
        raise UsageError(f"--with must be NAME=FOLDER (got {text!r})")
    if name in METHODS:
        raise UsageError(f"--with must be another name than those of the methods (got {name!r})")
    if not Path(folder).is_dir():
        raise UsageError(f"--with must be a folder with poses for each clip (got {text!r})")
    return ExternalSystem(name, Path(folder))


def system_variants(
    systems: Sequence[ExternalSystem], base: Options, contacts: Sequence[ContactDefinition], refine: bool = False
) -> list[Variant]:
    """Make a variant of each system by each definition of contact; with ``refine``, also our fit from its poses."""
    variants = [
        Variant(each.name, each.name, base, UNCHANGED, contacts[0], REFERENCE_METHOD, each.name, each.name, each)
        for each in systems
    ]
    for each in systems if refine else ():
        label, options = f"{each.name}, refined", replace(base, init="poses", priors=PriorsFile(each.root))
        folder = f"{each.name}+refined"
        variants.append(Variant(label, folder, options, UNCHANGED, contacts[0], each.name, each.name, label))
    return by_contact(variants, contacts)


def options_with_checksum(variant: Variant, clip: str) -> dict[str, object]:
    """Return a variant's options; of another system, with the checksum of its files (empty where they are missing)."""
    options = asdict(variant.options)
    if variant.system is None:
        return options
    try:
        return options | {"poses_sha256": sha256(variant.system.inputs(clip))}
    except InputError:  # reported when the files are read
        return options | {"poses_sha256": ""}


def external_result(variant: Variant, clip: Clip, masks: Masks) -> Reconstruction:
    """Read another system's poses at the frames at which our methods are evaluated. Raises ``InputError``."""
    assert variant.system is not None
    if variant.options.every_frame:
        return variant.system.result(clip, masks, clip.frames)
    visible = observed_frames(clip, masks.observed)
    return variant.system.result(clip, masks, visible.take(frame_indices(len(visible), variant.options.frames)).frames)


EVALUATION_CODE = "metrics/evaluate"
CHANGES_CODE = ("bench/inputs",)
EXTERNAL_SYSTEMS_CODE = (EVALUATION_CODE, "bench/grasps.py")
"""Code, besides a reconstruction's, that metrics, results of changed clips and results of other systems depend on."""


@dataclass(frozen=True)
class GraspTrial(Trial[GraspClipScores]):
    """A clip and the variants to run on it; results go to ``results/<variant's folder>/<clip>``."""

    variants: tuple[Variant, ...]
    contacts: tuple[ContactDefinition, ...] = CONTACT_DEFINITIONS
    """Definitions of contact for the metrics."""
    replay: bool = False
    """True if results are also simulated."""

    def failed(self, why: str, trace: str = "") -> GraspClipScores:
        return GraspClipScores(self.name, failure=why, trace=trace)

    def scores(self) -> GraspClipScores:
        """Reconstruct and evaluate a clip with every variant; failures of variants become scores."""
        clip = read_clip(self.sample.folder)
        checksum = input_sha256(self.sample.folder)
        scores, missing = dict[str, GraspVariantScore](), list[Variant]()
        for variant in self.variants:
            folder = _variant_folder(self, variant)
            known, _ = _existing_result(self, variant, clip.name, _changed_clip_checksum(checksum, variant, clip.name))
            if known is None or not _is_evaluation_current(known[1], self.contacts, self.replay):
                missing.append(variant)
            else:
                scores[variant.folder] = _read_score(variant, folder, known[1])
        if missing:
            scores |= _score_missing_variants(self, clip, missing, checksum)
        subject = str(clip.provenance.get("subject", ""))
        ordered = tuple(scores[variant.folder] for variant in self.variants if variant.folder in scores)
        return GraspClipScores(clip.name, clip.category, subject, clip.truth is not None, ordered, len(missing))


def _score_missing_variants(
    trial: GraspTrial, clip: Clip, variants: list[Variant], checksum: str
) -> dict[str, GraspVariantScore]:
    """Score the variants without a valid result; masks are read once, and each change of the clip is made once."""
    masks, scores = read_masks(clip), dict[str, GraspVariantScore]()

    def change(variant: Variant) -> str:
        return repr(variant.change)

    for _, same in groupby(sorted(variants, key=change), change):
        alike = list(same)
        changed = alike[0].change(clip, masks, alike[0].options.seed)
        unchanged_masks = masks.take(clip.index_of(changed[0].frames))
        for variant in alike:
            identity = _changed_clip_checksum(checksum, variant, clip.name)
            scores[variant.folder] = _run_variant(trial, variant, changed, unchanged_masks, identity)
    return scores


def _run_variant(
    trial: GraspTrial, variant: Variant, changed: tuple[Clip, Masks], masks: Masks, checksum: str
) -> GraspVariantScore:
    """Reconstruct a changed clip, evaluate against it and the unchanged ``masks``, and write the result.

    Errors of a method, and invalid or missing files of another system, become a failed score. Raises ``InputError``
    for other invalid files.
    """
    from getagrip.export.replay import simulate_replay
    from getagrip.export.scene import Scene
    from getagrip.metrics.evaluate import evaluate
    from getagrip.reconstruct import reconstruct

    clip, folder = changed[0], _variant_folder(trial, variant)
    try:
        known, why = _existing_result(trial, variant, clip.name, checksum)
        if known is not None:
            result = known[0]
        elif variant.system is not None:
            result = replace(external_result(variant, *changed), options=options_with_checksum(variant, clip.name))
        else:
            result = reconstruct(replace(clip, segments=()), changed[1], variant.options)
        metrics = evaluate(result, clip, masks, trial.contacts).metrics
        if trial.replay:
            has_joints = clip.hand.joints is not None
            metrics[REPLAY_STABILITY.name] = simulate_replay(Scene.of(result, clip)).stays if has_joints else np.nan
        write_result(result, folder, checksum, metrics, clip.folder, overwrite=True, made_by=_software_of(variant))
        if variant.change.other_hands:
            write_result_hands(clip, folder, input_sha256(clip.origin))
    except Exception as error:
        if isinstance(error, InputError) and variant.system is None:
            raise
        why = failed_outcome(clip.name, error).message
        return GraspVariantScore(variant.folder, {}, np.nan, np.nan, False, why, failed=True)
    return replace(_read_score(variant, folder, read_result_record(folder)), again=why)


def _is_evaluation_current(record: Json, contacts: Sequence[ContactDefinition], replay: bool) -> bool:
    """Return whether a result was evaluated by this code, by all ``contacts``; otherwise only this step is repeated."""
    same_code = record["software"].get("evaluation") == _evaluation_fingerprint()
    if replay and REPLAY_STABILITY.name not in record["metrics"]:
        return False
    return same_code and all(SCA.key(contact) in record["metrics"] for contact in contacts)


def _read_score(variant: Variant, folder: Path, record: Json) -> GraspVariantScore:
    metrics = {key: np.nan if value is None else float(value) for key, value in record["metrics"].items()}
    totals = (record["seconds"]["total"], record["energy"]["total"])
    seconds, energy = (np.nan if value is None else float(value) for value in totals)
    found = read_findings(folder / "result.json", record["findings"])
    serious, noted = (tuple(f.check for f in found if f.serious == kind) for kind in (True, False))
    keys = ("probability_right", "probability_right_in_camera")
    known = [read_probability(folder / "result.json", record[key], key) for key in keys]
    right, in_camera = (None if one is None else one.value for one in known)
    keep, keep_in_camera = (None if one is None else one.keep for one in known)
    return GraspVariantScore(
        variant.folder, metrics, seconds, energy, record["ambiguous"], record["message"], serious=serious, noted=noted,
        probability_right=right, probability_right_in_camera=in_camera, keep=keep, keep_in_camera=keep_in_camera,
    )  # fmt: skip


def _variant_folder(trial: GraspTrial, variant: Variant) -> Path:
    return trial.results / variant.folder / trial.sample.name


def _changed_clip_checksum(checksum: str, variant: Variant, clip: str) -> str:
    """Return the checksum of the changed clip, which differs from the folder's clip for ``evaluate``."""
    if variant.change == UNCHANGED:
        return checksum
    changed = f"{checksum} {variant.change} {variant.options.seed}"
    if inputs := variant.change.inputs(clip):
        changed += f" {files.sha256(inputs)}"
    return hashlib.sha256(changed.encode()).hexdigest()


def _existing_result(
    trial: GraspTrial, variant: Variant, clip: str, checksum: str
) -> tuple[tuple[Reconstruction, Json] | None, str]:
    """Return the ``valid_result`` of a variant; ``checksum`` is the changed clip's."""
    options, folder = options_with_checksum(variant, clip), _variant_folder(trial, variant)
    return valid_result(folder, checksum, variant.method, options, _software_of(variant), trial.overwrite)


def _software_of(variant: Variant) -> dict[str, str]:
    """Return the software that a variant's result depends on, and the checksum of the code of its metrics."""
    also: tuple[str, ...] = () if variant.change == UNCHANGED else CHANGES_CODE
    if variant.system is not None:
        also += EXTERNAL_SYSTEMS_CODE
    made = software_of_method(variant.method, *also) if variant.system is None else software_versions(*also)
    return made | {"evaluation": _evaluation_fingerprint()}


def _evaluation_fingerprint() -> str:
    """Return the checksum of the code of the metrics, including other packages' metrics."""
    return " with ".join([plugins.fingerprint(EVALUATION_CODE, "export/replay.py"), *METRICS.made_of()])


@dataclass(frozen=True)
class GraspBenchmark(Benchmark[GraspClipScores]):
    """Methods, or settings of methods, on the grasps of a source.

    Raises ``UsageError`` for contradictory options, ``InputError`` for an invalid list of grasps.
    """

    source: ClipSource
    options: Options
    """Options of all variants."""
    compared: ComparisonOptions

    def __post_init__(self) -> None:
        ablation = self.compared.ablation
        if ablation is not None and ablation not in ABLATIONS:
            raise unknown_choice_error("--ablation", ablation, ABLATIONS)
        settings = {"--ablation": ablation, "--hands": self.compared.hands, "--views": self.compared.views}
        given = [option for option, value in settings.items() if value]
        if len(given) > 1:
            raise UsageError(f"{given[0]} cannot be used with {' or '.join(given[1:])}")
        if self.compared.others and given:
            raise UsageError(f"--with cannot be used with {given[0]}")
        if self.compared.replay:
            plugins.import_extra("mujoco", "mujoco", "--replay")
        if self.compared.refine and not self.compared.others:
            raise UsageError("missing --with: --refine needs poses to start from")
        if self.compared.refine and self.options.init != "uniform":
            raise UsageError(f"--init {self.options.init} cannot be used with --refine, which starts from --with")
        _ = self.variants

    @cached_property
    def contacts(self) -> tuple[ContactDefinition, ...]:
        """Definitions of contact in the tables."""
        return contact_definitions_at(self.compared.contact or (self.source.contact_mm,))

    @cached_property
    def settings(self) -> Ablation | None:
        """Settings to compare; None: methods alone are compared."""
        if self.compared.hands:
            return hand_source_ablation([HandSource.of(text) for text in self.compared.hands])
        if self.compared.views:
            return view_ablation(self.compared.views)
        if self.compared.ablation is not None:
            return ABLATIONS[self.compared.ablation]
        return self.source.compared

    @property
    def name(self) -> str:
        """Name of the files of the tables."""
        own = "methods" if self.source.compared is None else self.source.dataset
        given = "hands" if self.compared.hands else "views" if self.compared.views else self.compared.ablation
        return given or own

    @cached_property
    def variants(self) -> list[Variant]:
        """Variants, one for each row of the tables."""
        methods = self.compared.methods
        if self.settings is None:
            ours = method_variants(methods, self.options, self.contacts)
        else:
            ours = ablation_variants(self.name, methods, self.options, self.contacts, self.settings)
        systems = [system_of(text) for text in self.compared.others]
        return ours + system_variants(systems, self.options, self.contacts, self.compared.refine)

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[GraspClipScores]]:
        distinct = tuple({variant.folder: variant for variant in self.variants}.values())
        for variant in distinct:
            files.remove_stale_folders(files.folder_inside(results, variant.folder))
        contacts = tuple(dict.fromkeys((*CONTACT_DEFINITIONS, *self.contacts)))
        replay = self.compared.replay
        return [GraspTrial(sample, results, overwrite, distinct, contacts, replay) for sample in samples]

    def failures(self, scores: GraspClipScores) -> list[Outcome]:
        """Return an outcome for a failed clip, or for each of its failed variants."""
        label = {variant.folder: variant.label for variant in self.variants}
        failed = [score for score in scores.scores if score.failed]
        own = [Outcome(f"{scores.name}: {label[score.variant]}", "failed", score.status) for score in failed]
        return super().failures(scores) + own

    def line(self, scores: GraspClipScores) -> str:
        if scores.failure:
            return ""
        failed = sum(score.failed for score in scores.scores)
        done = f"{scores.made - failed} done, {len(scores.scores) - scores.made} already done"
        again = Counter(score.again for score in scores.scores if score.again)
        why = "".join(f"; {count} done again, since {reason}" for reason, count in again.items())
        return f"{scores.name}: {done}{f', {failed} failed' if failed else ''}{why}"

    def entry(self, scores: GraspClipScores) -> LedgerEntry:
        """Make the ledger's entry; ``failed`` where the clip is unreadable or its process died."""
        failed = sum(score.failed for score in scores.scores)
        why = scores.failure or (f"{failed} of {len(scores.scores)} rows failed" if failed else "")
        return LedgerEntry("", "failed" if scores.failure else "done" if scores.made else "kept", why)

    def page(self, scores: Sequence[GraspClipScores]) -> BenchmarkPage | None:
        columns = self.compared.columns or self.source.columns
        parts = {clip.name: self.source.part_of(clip.name, clip.category) for clip in scores if clip.scores}
        tables = compare_variants(scores, self.variants, columns, lambda clip: parts[clip.name])
        title = "Methods" if self.settings is None else self.settings.title
        about, settings = _describe_run(self, scores), _describe_settings(self, scores)
        texts = {
            ".md": comparison_markdown(tables, title, about, settings),
            ".tex": comparison_latex(tables, title, about + settings),
        }
        rows = {"-clips.csv": clips_csv_rows(scores, self.variants), ".csv": comparison_csv_rows(tables)}
        plotted = (tables[0], title) if tables and self.settings is not None else None
        shown = terminal_table(tables[0], _describe_retained_share(self, scores)) if tables else ""
        content = comparison_json(tables, scores)
        if tables and (systems := self.source.published):
            ours = {table.title: table for table in tables} if tables[1:] else {parts.popitem()[1]: tables[0]}
            texts[".md"] += "\n".join(["", "Beside printed numbers:", "", *published_markdown(systems, ours), ""])
            content["published"] = {name: vars(system) for name, system in systems.items()}
        return BenchmarkPage(self.name, shown, texts, rows, content, plotted)


def _describe_run(bench: GraspBenchmark, scores: Sequence[GraspClipScores]) -> list[str]:
    good = sum(bool(clip.scores) for clip in scores)
    skipped = f", {len(scores) - good} failed and skipped" if good < len(scores) else ""
    return [
        f"{bench.source.title}: {format_count(good, 'clip')}{skipped}; made {date_and_commit()}",
        *_describe_retained_share(bench, scores),
    ]


def _describe_retained_share(bench: GraspBenchmark, scores: Sequence[GraspClipScores]) -> list[str]:
    """With ``--keep``, describe each variant's share of kept results, and the number of right ones among them."""
    keep, out = bench.compared.keep, list[str]()
    if keep.keep is None:
        return out
    metric = ADD_SYM if keep.keep_in == "hand" else ADD_SYM_CAM
    for variant in bench.variants:
        found = [one for clip in scores for one in clip.scores if one.variant == variant.folder]
        kept = [one for one in found if keep.mark(one.keep, one.keep_in_camera) == "kept"]
        right = sum(one.metrics.get(metric.name, 0.0) > 0.5 for one in kept)
        share = f"{len(kept)} of {len(found)} kept for {100.0 * keep.keep:.3g} % right in the {keep.keep_in}"
        out.append(f"{variant.label}: {share}, {right} of them right")
    return out


def _describe_settings(bench: GraspBenchmark, scores: Sequence[GraspClipScores]) -> list[str]:
    good = [clip for clip in scores if clip.scores]
    groups = independent_groups(good) if good else []
    units = format_count(len(groups), "clip")
    if len(set(groups)) < len(groups):
        units = f"{format_count(len(set(groups)), 'subject')}, all clips of one together"
    versions = ", ".join(f"{key} {version}" for key, version in software_versions().items())
    options = bench.options
    frames = f"{options.frames} frames" + (" and the others that follow them" if options.every_frame else "")
    return [
        f"{_describe_initial_poses(bench)}, {frames}, seed {options.seed}; the same frames, masks and evaluation for "
        "all",
        "per cent, means over clips, the best bold, the second best underlined; s: median seconds for a clip",
        f"in brackets: 95 % intervals by Student's t over {units}",
        f"contact: {' and '.join(contact.description for contact in bench.contacts)}, unless the row says otherwise; a "
        "method that fails on a clip scores 0 there",
        versions,
    ]


def _describe_initial_poses(bench: GraspBenchmark) -> str:
    options, thorough = bench.options, ", thorough" if bench.options.thorough else ""
    kind: str = options.init
    if options.priors is not None:
        more = "no others" if options.priors_only else "then uniform"
        kind = f"{options.init} of {options.priors.path.name}, sha256 {options.priors.sha256[:12]}, {more}"
    own = [v.method for v in bench.variants if v.system is None and method_of(v.method).as_published]
    but = f", but for {' and '.join(dict.fromkeys(own))}" if own else ""
    free = f"{FREE_SCALE_START_FACTOR * options.inits} where the scale is free{but}"
    most = "at most " if options.priors_only else ""
    return f"{most}{options.inits} initial poses ({kind}{thorough}; {free})"
