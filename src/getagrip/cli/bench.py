"""``getagrip bench``: all clips of a source by several methods, and the paper's tables of them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from glob import has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar, Union

from tyro.conf import arg, subcommand

from getagrip.batch.scheduling import Executors, SchedulingOptions
from getagrip.bench.options import ComparisonOptions
from getagrip.bench.sources.ho3d_sequences import Ho3dEval
from getagrip.bench.sources.recorded import DexYcb, DexYcbSequences, DexYcbTimelines, Hot3dTimelines, TimelineSource
from getagrip.bench.sources.recording import Recording
from getagrip.bench.sources.rendered_videos import ORACLE_NAMES, RenderedVideos
from getagrip.bench.sources.source import ClipFolder, ClipSource
from getagrip.bench.sources.synthetic_clips import SyntheticSource
from getagrip.cli.command import Command
from getagrip.errors import UsageError
from getagrip.fitting.options import Options, SearchOptions
from getagrip.io.options import Flag, Folder, OptionalFile

if TYPE_CHECKING:
    from getagrip.bench.grasps import GraspBenchmark
    from getagrip.bench.job import Benchmark
    from getagrip.bench.pixels.recording import RecordingBenchmark
    from getagrip.bench.pixels.videos import VideoBenchmark
    from getagrip.bench.sequences.segments import SegmentBenchmark
    from getagrip.bench.sequences.timelines import TimelineBenchmark

C = TypeVar("C", bound=ClipSource)
T = TypeVar("T", bound=TimelineSource)


@dataclass(frozen=True, kw_only=True)
class Bench(Command, Generic[C]):
    """The shared options and the run of all benchmarks; existing results are kept."""

    source: Annotated[C, arg(name="")]
    out: Folder
    """Folder of clips, results, tables and plots. Called again with the same folder, it continues where it stopped."""
    count: Annotated[int | None, arg(name="clips", metavar="N", help_behavior_hint="(default: all)")] = None
    """Use N clips, evenly sampled; of video, whose order is mixed, the first N."""
    json: OptionalFile = None
    """Write every number here, unrounded."""
    every_frame: Flag = False
    """Evaluate every frame of the clips, not only the 30 that all methods fit together."""
    overwrite: Flag = False
    """Recompute valid results, too. Damaged ones, and those of other inputs, options or code, always are."""
    search: Annotated[SearchOptions, arg(name="")] = field(default_factory=SearchOptions)
    share: Executors = field(default_factory=SchedulingOptions)

    @property
    def options(self) -> Options:
        """Options that all results share."""
        return Options(**vars(self.search), every_frame=self.every_frame or self.source.every_frame)

    def benchmark(self) -> Benchmark[Any]:
        """Make the benchmark that is run on every clip. Raises ``UsageError`` for options that do not fit."""
        raise NotImplementedError

    def run(self) -> int:
        """Make missing results and write the tables; return 1 if a clip or a method failed, else 0.

        Several calls may share a folder, whose ledger distributes the clips. Raises ``UsageError`` for options that do
        not fit and without clips, ``GetagripError`` for a ledger that cannot be written.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.engine import Engine
        from getagrip.batch.job import preload_solver
        from getagrip.batch.ledger import Ledger, ledger_folder
        from getagrip.bench.job import failure_of, run_trial
        from getagrip.bench.sources import sample_clips
        from getagrip.io import files
        from getagrip.io.terminal import print_note

        benchmark = self.benchmark()
        found, bad = sample_clips(self.source, self.out / "clips", self.count, self.debug, self.share)
        for outcome in bad:
            print_outcome(outcome, self.debug)
        if not found:
            print_note(f"{self.source.dataset}: no clip is left to run")
            return 1
        self.out.mkdir(parents=True, exist_ok=True)
        files.remove_stale_folders(self.out / "clips")
        chosen = [sample for sample in found if sample.name in self.share.shard]
        trials = benchmark.trials(chosen, files.folder_inside(self.out, "results"), self.overwrite)
        engine = Engine(run_trial, failure_of, benchmark.entry, repr(benchmark), prepare=preload_solver)
        scores, failures = [], len(bad)
        with (
            Ledger(ledger_folder(self.out, self.share.ledger)) as ledger,
            closing(self.share.ended(engine, trials, len(trials), ledger, "clips", few=0)) as ended,
        ):
            for one in ended:
                failed = benchmark.failures(one)
                for outcome in failed:
                    print_outcome(outcome, self.debug)
                if line := benchmark.line(one):
                    print(line)
                scores.append(one)
                failures += len(failed)
                if self.share.fail_fast and failures:
                    print_note("--fail-fast: the other clips are skipped")
                    break
        page = benchmark.page(sorted(scores, key=lambda one: one.name))
        if page is not None:
            print(*page.write(self.out, self.json), sep="\n")
        return 1 if failures else 0


@dataclass(frozen=True, kw_only=True)
class BenchGrasps(Bench[C], Generic[C]):
    """Compare methods on clips of grasps."""

    compared: Annotated[ComparisonOptions, arg(name="")] = field(default_factory=ComparisonOptions)

    def benchmark(self) -> GraspBenchmark:
        from getagrip.bench.grasps import GraspBenchmark

        return GraspBenchmark(self.source, self.options, self.compared)


@dataclass(frozen=True, kw_only=True)
class BenchSegments(Bench[DexYcbSequences]):
    """Find grasps in sequences."""

    def benchmark(self) -> SegmentBenchmark:
        from getagrip.bench.sequences.segments import SegmentBenchmark

        return SegmentBenchmark(self.source, self.options)


@dataclass(frozen=True, kw_only=True)
class BenchTimelines(Bench[T], Generic[T]):
    """Reconstruct timelines."""

    def benchmark(self) -> TimelineBenchmark:
        from getagrip.bench.sequences.timelines import TimelineBenchmark

        return TimelineBenchmark(self.source, self.options)


VIDEO_ABLATIONS_HINT = "(as pixels, the evidence beside the silhouette; default: none)"
ORACLES_HINT = f"(of {', '.join(ORACLE_NAMES)}; default: none)"


@dataclass(frozen=True, kw_only=True)
class BenchVideos(Bench[RenderedVideos]):
    """Draft rendered videos."""

    oracle: Annotated[tuple[str, ...], arg(metavar="NAME...", help_behavior_hint=ORACLES_HINT)] = ()
    """Also draft each video with the truth in place of a stage."""
    ablation: Annotated[str | None, arg(metavar="NAME", help_behavior_hint=VIDEO_ABLATIONS_HINT)] = None
    """Fit each draft in several settings, instead; hands and masks are the same. Only of options, of soft-hinge."""

    def benchmark(self) -> VideoBenchmark:
        from getagrip.bench.pixels.videos import VideoBenchmark
        from getagrip.cli.calls import run_call

        return VideoBenchmark(self.source, self.options, self.oracle, run_call, self.ablation)


@dataclass(frozen=True, kw_only=True)
class BenchRecording(Bench[Recording]):
    """Draft real images with known poses."""

    def benchmark(self) -> RecordingBenchmark:
        from getagrip.bench.pixels.recording import RecordingBenchmark
        from getagrip.cli.calls import run_draft

        if self.search != SearchOptions() or self.every_frame:
            raise UsageError("bench recording takes no options of the search, nor --every-frame: drafts have their own")
        return RecordingBenchmark(run_draft)


BENCHES: tuple[tuple[object, type[ClipSource]], ...] = (
    (BenchGrasps[SyntheticSource], SyntheticSource),
    (BenchGrasps[DexYcb], DexYcb),
    (BenchGrasps[Ho3dEval], Ho3dEval),
    (BenchSegments, DexYcbSequences),
    (BenchTimelines[DexYcbTimelines], DexYcbTimelines),
    (BenchTimelines[Hot3dTimelines], Hot3dTimelines),
    (BenchVideos, RenderedVideos),
    (BenchRecording, Recording),
    (BenchGrasps[ClipFolder], ClipFolder),
)
"""The subcommands: benchmark, and the source whose fields are options."""


def _bench_subcommands() -> object:
    kinds = [Annotated[bench, subcommand(source.dataset, description=source.__doc__)] for bench, source in BENCHES]
    return Union[tuple(kinds)]  # noqa: UP007


Benches = _bench_subcommands()
PATH_OPTIONS = ("--out", "--json", "--ledger", "--priors")
"""Options whose values are paths of other files than clips."""


def move_source_first(words: Sequence[str], sources: Collection[str]) -> list[str]:
    """Return the words behind ``bench`` with the source first, which users may write behind options."""
    if not words or words[0] in ("-h", "--help"):
        return list(words)
    alone = words[0] == ClipFolder.dataset and (len(words) == 1 or words[1].startswith("-"))  # a folder of that name
    if alone or (words[0] not in sources and not words[0].startswith("-")):
        return [ClipFolder.dataset, *words] if _is_folder(words[0]) else list(words)
    free = [n for n, word in enumerate(words) if n == 0 or words[n - 1] not in PATH_OPTIONS]
    place = next((n for n in free if words[n] in sources), None)
    if place is not None:
        return [words[place], *words[:place], *words[place + 1 :]]
    return [ClipFolder.dataset, *words] if any(_is_folder(words[n]) for n in free) else list(words)


def _is_folder(word: str) -> bool:
    return Path(word).exists() or has_magic(word)
