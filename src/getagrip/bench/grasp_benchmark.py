"""``getagrip bench`` on clips of grasps: clips x variants, then tables and, for an ablation, a plot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from getagrip.batch.job import Outcome
from getagrip.batch.ledger import LedgerEntry
from getagrip.bench import tables as bench_tables
from getagrip.bench.ablations import ABLATIONS, Ablation, ComparisonOptions, Variant, ablation_variants, method_variants
from getagrip.bench.comparison import compare_variants, independent_groups
from getagrip.bench.grasp_job import GraspClipScores, GraspTrial, system_of, system_variants
from getagrip.bench.job import Benchmark, BenchmarkPage, HandSource, Trial, hand_source_ablation
from getagrip.bench.sources import ClipSource, Sample
from getagrip.bench.tables import (
    clips_csv_rows,
    comparison_csv_rows,
    comparison_json,
    comparison_latex,
    comparison_markdown,
    terminal_table,
)
from getagrip.errors import UsageError, unknown_choice_error
from getagrip.fitting.methods import method_of
from getagrip.fitting.options import FREE_SCALE_START_FACTOR, Options
from getagrip.io import files, plugins
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import format_count
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition, contact_definitions_at
from getagrip.metrics.evaluate.metric import ADD_SYM, ADD_SYM_CAM
from getagrip.result import software_versions


@dataclass(frozen=True)
class GraspBenchmark(Benchmark[GraspClipScores]):
    """Methods, or settings of methods, on the grasps of a source. Raises ``UsageError``, and ``InputError``."""

    source: ClipSource
    options: Options
    """Options that all variants share."""
    compared: ComparisonOptions

    def __post_init__(self) -> None:
        ablation = self.compared.ablation
        if ablation is not None and ablation not in ABLATIONS:
            raise unknown_choice_error("--ablation", ablation, ABLATIONS)
        if ablation is not None and self.compared.hands:
            raise UsageError("--ablation cannot be used with --hands")
        if self.compared.others and (ablation is not None or self.compared.hands):
            raise UsageError("--with cannot be used with --ablation or --hands")
        if self.compared.replay:
            plugins.import_extra("mujoco", "mujoco", "--replay")
        if self.compared.refine and not self.compared.others:
            raise UsageError("missing --with: --refine needs poses to start from")
        if self.compared.refine and self.options.init != "uniform":
            raise UsageError(f"--init {self.options.init} cannot be used with --refine, which starts from --with")
        _ = self.variants

    @cached_property
    def contacts(self) -> tuple[ContactDefinition, ...]:
        """The definitions of contact in the tables."""
        return contact_definitions_at(self.compared.contact or (self.source.contact_mm,))

    @cached_property
    def settings(self) -> Ablation | None:
        """Settings that are compared besides methods."""
        if self.compared.hands:
            return hand_source_ablation([HandSource.of(text) for text in self.compared.hands])
        if self.compared.ablation is not None:
            return ABLATIONS[self.compared.ablation]
        return self.source.compared

    @property
    def name(self) -> str:
        """Name of the files of the tables."""
        own = "methods" if self.source.compared is None else self.source.dataset
        return "hands" if self.compared.hands else self.compared.ablation or own

    @cached_property
    def variants(self) -> list[Variant]:
        """The rows of the tables."""
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
        """Return the failed clip, or each of its failed variants."""
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
        """Make the ledger's entry; failed where the clip could not be read, or no process could do it."""
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
            texts[".md"] += "\n".join(
                ["", "Beside printed numbers:", "", *bench_tables.published_markdown(systems, ours), ""]
            )
            content["published"] = {name: vars(system) for name, system in systems.items()}
        return BenchmarkPage(self.name, shown, texts, rows, content, plotted)


def _describe_run(bench: GraspBenchmark, scores: Sequence[GraspClipScores]) -> list[str]:
    """Return what was run, and when."""
    good = sum(bool(clip.scores) for clip in scores)
    skipped = f", {len(scores) - good} failed and skipped" if good < len(scores) else ""
    return [
        f"{bench.source.title}: {format_count(good, 'clip')}{skipped}; made {date_and_commit()}",
        *_describe_retained_share(bench, scores),
    ]


def _describe_retained_share(bench: GraspBenchmark, scores: Sequence[GraspClipScores]) -> list[str]:
    """Say of each variant which share is kept, and how many of the kept are right, if that is asked for."""
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
    """How the numbers were made and are to be read, in sentences."""
    good = [clip for clip in scores if clip.scores]
    drawn = independent_groups(good) if good else []
    together = len(set(drawn)) < len(drawn)
    units = format_count(len(drawn), "clip")
    if together:
        units = f"{format_count(len(set(drawn)), 'subject')}, all clips of one together"
    versions = ", ".join(f"{key} {version}" for key, version in software_versions().items())
    return [
        f"{_describe_initial_poses(bench)}, {_describe_frames(bench.options)}, seed {bench.options.seed}; the same frames, masks and "
        "evaluation for all",
        "per cent, means over clips, the best bold, the second best underlined; s: median seconds for a clip",
        f"in brackets: 95 % intervals by Student's t over {units}",
        f"contact: {' and '.join(contact.description for contact in bench.contacts)}, unless the row says otherwise; a "
        "method that fails on a clip scores 0 there",
        versions,
    ]


def _describe_frames(options: Options) -> str:
    """Which frames are evaluated, in words."""
    return f"{options.frames} frames" + (" and the others that follow them" if options.every_frame else "")


def _describe_initial_poses(bench: GraspBenchmark) -> str:
    """How many initial poses the search has, and which, in words."""
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
