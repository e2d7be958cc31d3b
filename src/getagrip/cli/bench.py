"""The command that compares methods on a dataset."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.batch.share import Share
from getagrip.commands.command import Command
from getagrip.errors import UsageError
from getagrip.experiments.sources import SOURCES, names_in, source_of
from getagrip.experiments.sources.dexycb import DexYcbSequences
from getagrip.experiments.sources.timelines import Timelines
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options, SearchOptions
from getagrip.io.arguments import Flag, Folder, OptionalFile, OptionalFolder, one_of

if TYPE_CHECKING:
    Method = str
else:
    Method = Literal[tuple(METHODS)]


def _ablations(_: str) -> str:
    """The names that an option takes, loaded only to show its help."""
    from getagrip.experiments.settings import ABLATIONS

    return f"(one of {', '.join(ABLATIONS)}; default: none)"


@dataclass(frozen=True, kw_only=True)
class Bench(Command):
    """Compare methods on a dataset: the paper's tables, with intervals. Existing results are kept."""

    dataset: Annotated[
        Positional[str],
        arg(metavar="DATASET", help=f"{', '.join(SOURCES)}, or a folder of clips, with ground truth or without."),
    ]
    out: Folder
    """Where clips, results, tables and plots go. Called again with the same folder, it continues where it stopped."""
    methods: Annotated[tuple[Method, ...], arg(help_behavior_hint="(default: all but paper...)")] = ()
    """Methods to compare. Ablations compare one-dof and soft-hinge by default, departures the paper's. All but the
    paper's, which are slow and run where they are named."""
    ablation: Annotated[str | None, arg(metavar="NAME", help_behavior_hint=_ablations)] = None
    """Compare settings of each method, instead of the methods as they are."""
    split: Annotated[
        Literal["train", "validation", "all"] | None,
        one_of("train", "validation", "all"),
        arg(help_behavior_hint="(default: validation; all of a folder)"),
    ] = None
    """Which part of a dataset: train is for tuning, validation for choosing."""
    hands: Annotated[tuple[str, ...], arg(metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Compare hands of several estimators for the same clips, on the frames that all have: DIR holds clips of the same
    names, or a hand file <clip>.npz for each (import hands --out)."""
    others: Annotated[tuple[str, ...], arg(name="with", metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Other systems' results as further rows: DIR holds poses of each clip by its name, as for evaluate --poses, or
    result folders."""
    contact: Annotated[
        tuple[float, ...],
        arg(metavar="MM...", help_behavior_hint="(default: 10; of a folder that import made, as its clips were cut)"),
    ] = ()
    """Points of the object within MM of the hand's surface are in contact, in SCA, SCA-ADD and SCA-IOU; rows for each
    MM. The paper's is 0 on ARCTIC."""
    clips: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Use N clips, evenly sampled."""
    only: OptionalFile = None
    """Use the clips that FILE names, one a line; of a dataset no others are imported."""
    preset: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """What is done to the input. synthetic: clean (the default: nothing); moderate, strong or estimated (noise of hands
    and masks); wild (moderate noise, and a mean shape of unknown scale); measured (that, and deformed, with motion as
    measured). dexycb-segments: none (the default), moderate, strong or estimated (noise of hands and masks). Timelines
    have exact, moderate or strong (noise of hands), ragged (strong, and noise of masks), and all (the default: each of
    these). Other datasets have none."""
    root: OptionalFolder = None
    """dexycb..., hot3d-timelines, artigrasp...: the dataset's folder, as for import."""
    meshes: OptionalFolder = None
    """dexycb: the folder of the YCB models."""
    shortest: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 2)")] = None
    """artigrasp...: frames of the shortest grasp, as for import."""
    search: Annotated[SearchOptions, arg(name="")] = field(default_factory=SearchOptions)
    every_frame: Flag = False
    """Evaluate every frame of the clips, not only the 30 that all methods fit together."""
    share: Annotated[Share, arg(name="")] = field(default_factory=Share)
    json: OptionalFile = None
    """Write every number here, unrounded."""
    overwrite: Flag = False
    """Recompute good results, too. Those of other inputs, options or code, and damaged ones, are in any case."""

    def run(self) -> int:
        from getagrip.commands.bench import Plan, bench
        from getagrip.experiments.hand_sources import HandSource
        from getagrip.experiments.other_systems import system_of

        source = source_of(
            self.dataset, split=self.split, preset=self.preset, root=self.root, meshes=self.meshes,
            shortest=self.shortest, only=None if self.only is None else names_in(self.only),
        )  # fmt: skip
        options = Options(**vars(self.search), every_frame=self.every_frame)
        if isinstance(source, Timelines):
            return self._whole(source, options)
        hands = tuple(HandSource.of(text) for text in self.hands)
        systems = tuple(system_of(text) for text in self.others)
        plan = Plan(
            source, self.out, count=self.clips, methods=self.methods, ablation=self.ablation, hands=hands,
            systems=systems, contact_mm=self.contact, options=options, share=self.share,
            overwrite=self.overwrite, json=self.json,
        )  # fmt: skip
        return bench(plan, self.debug)

    def _whole(self, source: Timelines, options: Options) -> int:
        """The benchmarks of whole sequences: one method, and the definition of a grasp that the truth has."""
        from getagrip.commands.bench_segments import bench_segments
        from getagrip.commands.bench_sequences import Plan
        from getagrip.commands.bench_timelines import bench_timelines

        given = {
            "methods": self.methods, "ablation": self.ablation, "hands": self.hands, "with": self.others,
            "contact": self.contact,
        }  # fmt: skip
        for name, value in given.items():
            if value:
                raise UsageError(f"--{name}: got {value}, expected none with {self.dataset}")
        plan = Plan(source, self.out, options, self.clips, self.share, self.overwrite, self.json)
        return (bench_segments if isinstance(source, DexYcbSequences) else bench_timelines)(plan, self.debug)
