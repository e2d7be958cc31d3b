"""``getagrip bench``: clips x variants, then tables and, for an ablation, a plot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.engine import Engine
from getagrip.batch.entries import Entry
from getagrip.batch.job import Outcome, load
from getagrip.batch.share import ALONE, Share
from getagrip.errors import UsageError
from getagrip.evaluation.other_poses import OtherSystem
from getagrip.experiments.comparison import Table, compare, groups
from getagrip.experiments.hand_sources import HandSource, comparison
from getagrip.experiments.other_systems import system_variants
from getagrip.experiments.settings import ABLATIONS, Ablation
from getagrip.experiments.sources import ClipSource, samples
from getagrip.experiments.stamp import stamp
from getagrip.experiments.tables import as_json, latex, markdown, terminal, write_clips_csv, write_csv
from getagrip.experiments.trials import Scores, Trial, run
from getagrip.experiments.variants import Variant, ablation_variants, method_variants
from getagrip.fitting.methods import method_of
from getagrip.fitting.options import WITH_FREE_SCALE, Options
from getagrip.io import files, leftovers
from getagrip.io.counts import counted
from getagrip.io.terminal import console, report
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition, at_millimetres
from getagrip.result import software


@dataclass(frozen=True)
class Plan:
    """What to run."""

    source: ClipSource
    out: Path
    count: int | None = None
    """Use this many clips, evenly sampled; None: all."""
    methods: tuple[str, ...] = ()
    """None: all of them, or those that the ablation is about."""
    ablation: str | None = None
    hands: tuple[HandSource, ...] = ()
    """Compare the hands of these sources, instead of an ablation of the table."""
    systems: tuple[OtherSystem, ...] = ()
    """Compare the results of these systems, too."""
    contact_mm: tuple[float, ...] = ()
    """Thresholds of contact in the tables [mm]; none: that of the source."""
    options: Options = field(default_factory=Options)
    """What all variants have in common."""
    share: Share = ALONE
    overwrite: bool = False
    json: Path | None = None

    def __post_init__(self) -> None:
        if self.ablation is not None and self.ablation not in ABLATIONS:
            raise UsageError(f"--ablation: got {self.ablation!r}, expected one of {', '.join(ABLATIONS)}")
        if self.ablation is not None and self.hands:
            raise UsageError(f"--ablation: got {self.ablation} and --hands, expected one of them")
        if self.systems and (self.ablation is not None or self.hands):
            raise UsageError("--with: got other systems, expected none with --ablation and --hands")

    @cached_property
    def contacts(self) -> tuple[ContactDefinition, ...]:
        """The definitions of contact in the tables. Raises ``UsageError`` for impossible ones, and ``InputError``."""
        return at_millimetres(self.contact_mm or (self.source.contact_mm,))

    @cached_property
    def settings(self) -> Ablation | None:
        """What is compared besides methods. Raises ``UsageError``."""
        if self.hands:
            return comparison(self.hands)
        return None if self.ablation is None else ABLATIONS[self.ablation]

    @property
    def name(self) -> str:
        """What the files of the tables are called."""
        return "hands" if self.hands else self.ablation or "methods"

    def variants(self) -> list[Variant]:
        """The rows of the tables."""
        if self.settings is None:
            ours = method_variants(self.methods, self.options, self.contacts)
            return ours + system_variants(self.systems, self.options, self.contacts)
        return ablation_variants(self.name, self.methods, self.options, self.contacts, self.settings)

    @property
    def title(self) -> str:
        """What the tables are called."""
        return "Methods" if self.settings is None else self.settings.title


def bench(plan: Plan, debug: bool) -> int:
    """Run what has no result yet and write the tables; 1 if a clip or a method failed, else 0.

    Several calls may share a folder: its ledger says who does which clip. Raises ``UsageError`` where the call is wrong
    or there are no clips, ``GetagripError`` where the ledger cannot be written.
    """
    variants = plan.variants()
    clips, bad = samples(plan.source, plan.out / "clips", plan.count, debug, plan.share)
    for outcome in bad:
        print_outcome(outcome, debug)
    if not clips:
        return 1
    plan.out.mkdir(parents=True, exist_ok=True)
    scores = []
    results = files.folder_inside(plan.out, "results")
    distinct = tuple({variant.folder: variant for variant in variants}.values())
    for folder in (plan.out / "clips", *(files.folder_inside(results, variant.folder) for variant in distinct)):
        leftovers.sweep(folder)
    contacts = tuple(dict.fromkeys((*CONTACT_DEFINITIONS, *plan.contacts)))
    chosen = [sample for sample in clips if sample.name in plan.share.shard]
    trials = [Trial(sample, distinct, results, plan.overwrite, contacts) for sample in chosen]
    failures = len(bad)
    engine = Engine(work=run, lost=_lost, entry=_entry, options=repr(distinct), prepare=load)
    with closing(plan.share.ended(engine, trials, plan.out, "clips", few=0)) as ended:
        for clip in ended:
            failures += _report(clip, variants, debug)
            scores.append(clip)
            if plan.share.fail_fast and failures:
                report("--fail-fast: no other clip is begun")
                break
    scores.sort(key=lambda clip: clip.clip)
    tables = compare(scores, variants)
    if tables:
        console().print(terminal(tables[0]))
    _write(plan, tables, scores, variants)
    return 1 if failures else 0


def _lost(trial: Trial, why: str) -> Scores:
    """The scores of a clip that no process could do."""
    return Scores(trial.name, failure=why)


def _entry(scores: Scores) -> Entry:
    """What the ledger is to say of a clip: failed where it could not be read, or no process could do it."""
    failed = sum(score.failed for score in scores.scores)
    why = scores.failure or (f"{failed} of {len(scores.scores)} rows failed" if failed else "")
    return Entry("", "failed" if scores.failure else "done" if scores.made else "kept", why)


def _report(clip: Scores, variants: Sequence[Variant], debug: bool) -> int:
    """A line for the clip and one for each failure; how many those are."""
    if clip.failure:
        print_outcome(Outcome(clip.clip, "failed", clip.failure, clip.trace), debug)
        return 1
    failed = [score for score in clip.scores if score.failed]
    label = {variant.folder: variant.label for variant in variants}
    for score in failed:
        print_outcome(Outcome(f"{clip.clip}: {label[score.variant]}", "failed", score.status), debug)
    done = f"{clip.made - len(failed)} done, {len(clip.scores) - clip.made} already done"
    again = Counter(score.again for score in clip.scores if score.again)
    why = "".join(f"; {count} done again, since {reason}" for reason, count in again.items())
    print(f"{clip.clip}: {done}{f', {len(failed)} failed' if failed else ''}{why}")
    return len(failed)


def _write(plan: Plan, tables: Sequence[Table], scores: Sequence[Scores], variants: Sequence[Variant]) -> None:
    """Tables, every clip's numbers and the plot, into the output folder."""
    name = plan.name
    about, settings = _about(plan, scores), _settings(plan, scores)
    written = [plan.out / f"{name}{end}" for end in ("-clips.csv", ".csv", ".md", ".tex")]
    write_clips_csv(scores, variants, written[0])
    write_csv(tables, written[1])
    files.write_text(written[2], markdown(tables, plan.title, about, settings))
    files.write_text(written[3], latex(tables, plan.title, about + settings))
    if plan.settings is not None and tables:
        from getagrip.experiments.plots import plot

        written.append(plan.out / f"{name}.png")
        plot(tables[0], plan.title, written[-1])
    if plan.json is not None:
        files.write_json(plan.json, as_json(tables, scores))
        written.append(plan.json)
    print(*written, sep="\n")


def _about(plan: Plan, scores: Sequence[Scores]) -> list[str]:
    """What was run, and when."""
    good = sum(bool(clip.scores) for clip in scores)
    skipped = f", {len(scores) - good} failed and skipped" if good < len(scores) else ""
    return [f"{plan.source.title}: {counted(good, 'clip')}{skipped}; made {stamp()}"]


def _settings(plan: Plan, scores: Sequence[Scores]) -> list[str]:
    """How the numbers were made and are to be read, in sentences."""
    good = [clip for clip in scores if clip.scores]
    drawn = groups(good) if good else []
    together = len(set(drawn)) < len(drawn)
    units = counted(len(drawn), "clip")
    if together:
        units = f"{counted(len(set(drawn)), 'subject')}, all clips of one together"
    versions = ", ".join(f"{key} {version}" for key, version in software().items())
    return [
        f"{_initial_poses(plan)}, {_frames(plan.options)}, seed {plan.options.seed}; the same frames, masks and "
        "evaluation for all",
        "per cent, means over clips, the best bold, the second best underlined; s: median seconds for a clip",
        f"in brackets: 95 % intervals by Student's t over {units}",
        f"contact: {' and '.join(contact.description for contact in plan.contacts)}, unless the row says otherwise; a "
        "method that fails on a clip scores 0 there",
        versions,
    ]


def _frames(options: Options) -> str:
    """Which frames are evaluated, in words."""
    return f"{options.frames} frames" + (" and the others that follow them" if options.every_frame else "")


def _initial_poses(plan: Plan) -> str:
    """How many initial poses the search has, and which, in words."""
    options, thorough = plan.options, ", thorough" if plan.options.thorough else ""
    kind: str = options.init
    if options.priors is not None:
        more = "no others" if options.priors_only else "then uniform"
        kind = f"{options.init} of {options.priors.path.name}, sha256 {options.priors.sha256[:12]}, {more}"
    published = [v.method for v in plan.variants() if v.system is None and method_of(v.method).as_published]
    but = f", but for {' and '.join(dict.fromkeys(published))}" if published else ""
    free = f"{WITH_FREE_SCALE * options.inits} where the scale is free{but}"
    most = "at most " if options.priors_only else ""
    return f"{most}{options.inits} initial poses ({kind}{thorough}; {free})"
